"""The service: photographs come in over HTTP, bitstreams and pictures go out.

In the order in which a job meets them:

    __main__        the command line; serve, web and worker
    settings        what the operator may set
    supervisor      keeps web process and workers running (with lifeline, stopping, listening)
    web, app        the web process and its application
    middleware      limits on bodies, headers on answers
    problems        errors as problem documents
    job_routes      POST /encode, GET and DELETE /jobs (with submission, bodies, views, parts)
    jobs            what a job is; the protocol of a job table
    sqlite_jobs     the job table in SQLite
    storage         files that are whole or absent (opened, as the table is, by backends)
    worker          claims a job, follows its encode, publishes the result
    encode_process  the worker's side of the encoding process
    encode_child    the encoding process itself
    picture_routes  GET and POST /decode, GET /bitstreams (with decoding, pictures)

Only encode_child imports the encoder, and with it torch.
"""
