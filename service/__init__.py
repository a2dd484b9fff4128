"""The HTTP service: photographs come in, bitstreams and pictures go out.

The rooms and modules; each imports only from those above it:

    keys            API keys, how often each may ask, links that stand in for one
    logs            what the processes write to standard error
    settings        what the operator may set
    process/        the processes of a service, how they end, and what strangers' pictures cannot reach
    storage/        source images and bitstreams, in a folder or in a bucket
    jobs/           the job table, in SQLite or in PostgreSQL
    opening         opens the job table and the storage that the settings name
    worker/         claims a job, has it encoded by an encoder process, publishes the bitstream
    web/guards/     limits, callers and refusals, before a body is read
    web/helpers/    what strangers sent is read and drawn by helper processes, by turns
    web/submitting/ from the body of a request to a job that can succeed
    web/routes/     what each request is answered with
    web/            the application and its server
    checking        whether an installation can work

`python -m service` is the command line. Only worker/encoder.py and, for a preview, a helper import the encoder; only
the first of them torch.
"""
