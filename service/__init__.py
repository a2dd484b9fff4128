"""The HTTP service: photographs come in, bitstreams and pictures go out.

The packages and modules; each imports only from those above it:

    errors          the errors that several packages share
    keys            API keys, links that stand in for one
    logs            what the processes write to standard error
    settings        what the operator may set
    process/        the processes of a service, and how they end
    storage/        source images and bitstreams, in a folder or in a bucket
    pictures        the picture files that can be made of a bitstream or an image
    jobs/           the job table, in SQLite or in PostgreSQL
    sandbox/        reads what strangers sent, in confined processes, one for each task
    opening         opens the job table and the storage that the settings name
    worker/         claims a job, has it encoded in the sandbox, publishes the bitstream
    api/            the routes, what they answer, and the application around them
    checking        whether an installation can work

page/ has no Python: the files of the page. `python -m service` is the command line. Only sandbox/tasks.py imports the
encoder, and with two of its profiles torch.
"""
