"""The HTTP service: photographs come in, bitstreams and pictures go out.

The rooms and modules; each imports only from those above it:

    keys            API keys, links that stand in for one
    logs            what the processes write to standard error
    settings        what the operator may set
    process/        the processes of a service, how they end, and what strangers' pictures cannot reach
    storage/        source images and bitstreams, in a folder or in a bucket
    jobs/           the job table, in SQLite or in PostgreSQL
    opening         opens the job table and the storage that the settings name
    worker/         claims a job, has it encoded by an encoder process, publishes the bitstream
    api/problems    refusals, as problem documents
    api/turns       how much clients may have run at once
    web/helpers/    what strangers sent is read and drawn by helper processes, by turns
    web/            the files of the page
    api/            the routes, what they answer, and the application around them
    checking        whether an installation can work

`python -m service` is the command line. Only worker/encoder.py and, for a preview, a helper import the encoder; only
the first of them torch.
"""
