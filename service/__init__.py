"""The HTTP service: images come in, bitstreams and pictures go out.

Read api/routes.py first, which lists the routes; then api/encode.py, which makes a job of a request; jobs/table.py,
where the job waits; worker/loop.py and worker/attempt.py, which claim and finish it; and sandbox/tasks.py, which
encodes. CONTRIBUTING.md follows one request through them.

The packages and modules; each imports only from those above it:

    errors          errors that several packages share
    keys            API keys, and links that work without a key
    logs            what the processes write to standard error
    settings        the operator's settings
    processes       processes and how they end
    storage/        source images and bitstreams, in a folder or in a bucket
    pictures        picture files of bitstreams and images
    jobs/           the job table, in SQLite or in PostgreSQL
    sandbox/        reads uploads in confined processes, one for each task
    opening         opens the job table and the storage that the settings name
    worker/         claims a job, has it encoded in the sandbox, publishes the bitstream
    api/            the routes, what they answer, and the application around them
    checking        checks of an installation
    commands        the command line

page/ has no Python: it contains the files of the page. Only sandbox/tasks.py
imports the encoder, and PyTorch for one profile.
"""
