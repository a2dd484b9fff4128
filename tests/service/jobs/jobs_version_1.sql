-- A job table as version 1 of the schema wrote it: one job done, one waiting.
CREATE TABLE jobs (
    number          INTEGER PRIMARY KEY AUTOINCREMENT,
    id              TEXT NOT NULL UNIQUE,
    state           TEXT NOT NULL DEFAULT 'queued' CHECK (state IN ('queued', 'running', 'done', 'failed')),
    idempotency_key TEXT UNIQUE,
    fingerprint     TEXT NOT NULL,
    request         TEXT NOT NULL,
    image           TEXT NOT NULL,
    attempt         INTEGER NOT NULL DEFAULT 0,
    crashes         INTEGER NOT NULL DEFAULT 0,
    worker          TEXT,
    lease_until     REAL,
    created_at      REAL NOT NULL,
    started_at      REAL,
    finished_at     REAL,
    result          TEXT CHECK ((state = 'done') = (result IS NOT NULL)),
    error           TEXT
);
CREATE INDEX jobs_by_state ON jobs (state, number);
CREATE TABLE trace (
    job   INTEGER NOT NULL REFERENCES jobs (number) ON DELETE CASCADE,
    place INTEGER NOT NULL,
    point TEXT NOT NULL,
    PRIMARY KEY (job, place)
) WITHOUT ROWID;
INSERT INTO jobs (number, id, state, fingerprint, request, image, attempt, created_at, started_at, finished_at, result)
VALUES (5, 'aaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaa', 'done', 'f',
    '{"budget_kind": "bpp", "budget_value": 0.3, "profile": "paper", "time_limit_s": 60.0}',
    '{"format": "PNG", "width": 64, "height": 48, "size_bytes": 1000}', 1, 1.5, 2.5, 3.5,
    '{"bitstream_key": "bitstreams/x.1.sg", "sha256": "abababababababababababababababababababababababababababababababab", "stats": {"bytes": 100, "psnr": null}}');
INSERT INTO trace VALUES (5, 0, '{"step": 0}'), (5, 1, '{"step": 1}');
INSERT INTO jobs (number, id, idempotency_key, fingerprint, request, image, created_at)
VALUES (7, 'bbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbb', 'key', 'f',
    '{"budget_kind": "bpp", "budget_value": 0.3, "profile": "paper", "time_limit_s": 60.0}',
    '{"format": "PNG", "width": 64, "height": 48, "size_bytes": 1000}', 4.5);
PRAGMA user_version = 1;
