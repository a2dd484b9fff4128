"""The HTTP service: photographs come in, bitstreams and pictures go out.

The rooms and modules; each imports only from those above it:

    keys            API keys, how often each may ask, links that stand in for one
    logs            what the processes write to standard error
    settings        what the operator may set
    process/        the processes of a service, and how they end
    storage/        source images and bitstreams, in a folder or in a bucket
    jobs/           the job table, in SQLite or in PostgreSQL
    sandbox/        reads what strangers sent, in confined processes, one for each task
    opening         opens the job table and the storage that the settings name
    worker/         claims a job, has it encoded in the sandbox, publishes the bitstream
    web/guards/     limits, callers and refusals, before a body is read
    web/submitting/ from the body of a request to a job that can succeed
    web/routes/     what each request is answered with
    web/            the application and its server
    checking        whether an installation can work

`python -m service` is the command line. Only sandbox/tasks.py imports the encoder, and with two of its profiles torch.
"""
