"""The service: photographs come in over HTTP, bitstreams and pictures go out.

In the order in which a job meets them:

    __main__        the command line; serve, web and worker
    settings        what the operator may set
    supervisor      keeps web process and workers running (with lifeline, stopping, listening)
    web, app        the web process and its application
    connections     limits on connections and on the heads of requests
    middleware      limits on bodies, headers on answers
    gate            who calls, before a body is read (with keys)
    problems        errors as problem documents
    job_routes      POST /encode, GET and DELETE /jobs, links (with submission, bodies, views, parts)
    event_routes    GET /jobs/ID/events
    jobs            what a job is; the protocol of a job table
    sql_jobs        the job table, whichever database it is in (with sql_statements)
    sqlite_jobs     the job table in SQLite
    postgres_jobs   the job table in PostgreSQL (with postgres_engine, which wakes workers)
    storage         files that are whole or absent; object_storage the same in a bucket (both opened by backends)
    worker          claims a job, follows its encode, publishes the result
    encode_process  the worker's side of the encoding process
    encode_child    the encoding process itself
    picture_routes  GET and POST /decode, GET /bitstreams (with decoding, pictures)
    sweeping        what kills left behind, and jobs past their time
    checking        whether an installation can work
    health_routes   GET /livez, /readyz and /metrics (with metrics)

Only encode_child imports the encoder, and with it torch.
"""
