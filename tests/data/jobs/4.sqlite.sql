BEGIN TRANSACTION;
CREATE TABLE deliveries (
    job      TEXT NOT NULL,
    address  TEXT NOT NULL,
    body     TEXT NOT NULL,
    ended_at DOUBLE PRECISION NOT NULL,
    due_at   DOUBLE PRECISION NOT NULL,
    PRIMARY KEY (job, address)
);
INSERT INTO "deliveries" VALUES('aaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaa','https://app.example/pictures','{"type": "job.done", "timestamp": "2026-11-30T02:50:45.004642+00:00", "data": {"id": "aaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaa", "key": "ann", "state": "done", "attempt": 1, "error": null, "bytes": 100, "sha256": "abababababababababababababababababababababababababababababababab"}}',1.79600704500503468514e+09,1.7960070450050356388e+09);
INSERT INTO "deliveries" VALUES('bbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbb','https://app.example/pictures','{"type": "job.failed", "timestamp": "2026-11-30T02:50:45.034520+00:00", "data": {"id": "bbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbb", "key": null, "state": "failed", "attempt": 1, "error": {"code": "refused", "detail": "no"}, "bytes": null, "sha256": null}}',1.79600704503476023676e+09,1.79600704503476142886e+09);
CREATE TABLE jobs (
    number          INTEGER PRIMARY KEY AUTOINCREMENT,
    id              TEXT NOT NULL UNIQUE,
    owner           TEXT NOT NULL DEFAULT '',
    priority        TEXT NOT NULL DEFAULT 'interactive' CHECK (priority IN ('interactive', 'bulk')),
    state           TEXT NOT NULL DEFAULT 'queued' CHECK (state IN ('queued', 'running', 'done', 'failed')),
    idempotency_key TEXT,
    fingerprint     TEXT NOT NULL,
    request         TEXT NOT NULL,
    image           TEXT NOT NULL,
    attempt         INTEGER NOT NULL DEFAULT 0,
    crashes         INTEGER NOT NULL DEFAULT 0,
    worker          TEXT,
    lease_until     DOUBLE PRECISION,
    created_at      DOUBLE PRECISION NOT NULL,
    started_at      DOUBLE PRECISION,
    finished_at     DOUBLE PRECISION,
    result          TEXT CHECK ((state = 'done') = (result IS NOT NULL)),
    error           TEXT,
    image_bytes     BIGINT NOT NULL,
    file_bytes      BIGINT NOT NULL DEFAULT 0,
    stopped         INTEGER NOT NULL DEFAULT 0,
    losses          INTEGER NOT NULL DEFAULT 0,
    UNIQUE (owner, idempotency_key)
);
INSERT INTO "jobs" VALUES(1,'aaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaa','ann','interactive','done','the key','f','{"budget_kind": "bpp", "budget_value": 1.0, "profile": "rd", "time_limit_s": 60.0, "tune": "psnr", "effort": 5}','{"format": "PNG", "width": 64, "height": 48, "size_bytes": 1000}',1,0,'w',1.79600710499392938611e+09,1.79600704497438240048e+09,1.79600704498625874522e+09,1.79600704500464200975e+09,'{"bitstream_key": "bitstreams/aaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaa.1.sg", "sha256": "abababababababababababababababababababababababababababababababab", "stats": {"bytes": 100, "psnr": null}}',NULL,1000,100,0,0);
INSERT INTO "jobs" VALUES(2,'bbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbb','','interactive','failed',NULL,'f','{"budget_kind": "bpp", "budget_value": 1.0, "profile": "rd", "time_limit_s": 60.0, "tune": "psnr", "effort": 5}','{"format": "PNG", "width": 64, "height": 48, "size_bytes": 1000}',1,0,'w',1.79600710502465057373e+09,1.79600704501385402675e+09,1.79600704502465200428e+09,1.79600704503452014921e+09,NULL,'{"code": "refused", "detail": "no"}',1000,0,0,0);
INSERT INTO "jobs" VALUES(3,'cccccccccccccccccccccccccccccccc','bob','interactive','running',NULL,'f','{"budget_kind": "bpp", "budget_value": 1.0, "profile": "rd", "time_limit_s": 60.0, "tune": "psnr", "effort": 5}','{"format": "PNG", "width": 64, "height": 48, "size_bytes": 1000}',1,0,'w',1.79600710506190228456e+09,1.79600704504996752739e+09,1.79600704505442667008e+09,NULL,NULL,NULL,1000,0,0,0);
INSERT INTO "jobs" VALUES(4,'dddddddddddddddddddddddddddddddd','','interactive','queued',NULL,'f','{"budget_kind": "bpp", "budget_value": 1.0, "profile": "rd", "time_limit_s": 60.0, "tune": "psnr", "effort": 5}','{"format": "PNG", "width": 64, "height": 48, "size_bytes": 1000}',1,0,'w',4e9,1.79600704507254648207e+09,NULL,NULL,NULL,NULL,1000,0,0,0);
INSERT INTO "jobs" VALUES(5,'eeeeeeeeeeeeeeeeeeeeeeeeeeeeeeee','ann','bulk','queued',NULL,'f','{"budget_kind": "bpp", "budget_value": 1.0, "profile": "rd", "time_limit_s": 60.0, "tune": "psnr", "effort": 5}','{"format": "PNG", "width": 64, "height": 48, "size_bytes": 1000}',0,0,NULL,NULL,1.79600704508005738256e+09,NULL,NULL,NULL,NULL,1000,0,0,0);
CREATE TABLE served (
    owner TEXT PRIMARY KEY,
    at    DOUBLE PRECISION NOT NULL
);
INSERT INTO "served" VALUES('ann',1.79600704498625874522e+09);
INSERT INTO "served" VALUES('',1.79600704502465200428e+09);
INSERT INTO "served" VALUES('bob',1.79600704505442667008e+09);
CREATE TABLE stored (
    owner TEXT NOT NULL,
    state TEXT NOT NULL,
    jobs  BIGINT NOT NULL,
    bytes BIGINT NOT NULL,
    PRIMARY KEY (owner, state)
);
INSERT INTO "stored" VALUES('ann','queued',1,1000);
INSERT INTO "stored" VALUES('ann','running',0,0);
INSERT INTO "stored" VALUES('ann','done',1,1100);
INSERT INTO "stored" VALUES('','queued',1,1000);
INSERT INTO "stored" VALUES('','running',0,0);
INSERT INTO "stored" VALUES('','failed',1,1000);
INSERT INTO "stored" VALUES('bob','queued',0,0);
INSERT INTO "stored" VALUES('bob','running',1,1000);
CREATE TABLE totals (
    name   TEXT PRIMARY KEY,
    amount DOUBLE PRECISION NOT NULL
);
INSERT INTO "totals" VALUES('finished',1.0);
INSERT INTO "totals" VALUES('encode_seconds',1.83832645416259765625e-02);
INSERT INTO "totals" VALUES('failed',1.0);
CREATE TABLE trace (
    job   BIGINT NOT NULL REFERENCES jobs (number) ON DELETE CASCADE,
    place INTEGER NOT NULL,
    point TEXT NOT NULL,
    PRIMARY KEY (job, place)
);
INSERT INTO "trace" VALUES(1,0,'{"step": 1}');
INSERT INTO "trace" VALUES(3,0,'{"step": 1}');
INSERT INTO "trace" VALUES(3,1,'{"step": 2}');
CREATE TABLE workers (
    name    TEXT PRIMARY KEY,
    seen_at DOUBLE PRECISION NOT NULL
);
INSERT INTO "workers" VALUES('w',1.79600704496182250972e+09);
CREATE INDEX deliveries_by_time ON deliveries (address, due_at);
CREATE INDEX jobs_by_state ON jobs (state, number);
CREATE INDEX jobs_by_owner ON jobs (owner, number);
CREATE TRIGGER jobs_come AFTER INSERT ON jobs BEGIN 
INSERT INTO stored VALUES (NEW.owner, NEW.state, 1, NEW.image_bytes + NEW.file_bytes)
ON CONFLICT (owner, state) DO UPDATE SET jobs = jobs + 1, bytes = bytes + excluded.bytes
; END;
CREATE TRIGGER jobs_go AFTER DELETE ON jobs BEGIN 
UPDATE stored SET jobs = jobs - 1, bytes = bytes - OLD.image_bytes - OLD.file_bytes
WHERE owner = OLD.owner AND state = OLD.state
; END;
CREATE TRIGGER jobs_change AFTER UPDATE OF owner, state, image_bytes, file_bytes ON jobs BEGIN 
UPDATE stored SET jobs = jobs - 1, bytes = bytes - OLD.image_bytes - OLD.file_bytes
WHERE owner = OLD.owner AND state = OLD.state
; 
INSERT INTO stored VALUES (NEW.owner, NEW.state, 1, NEW.image_bytes + NEW.file_bytes)
ON CONFLICT (owner, state) DO UPDATE SET jobs = jobs + 1, bytes = bytes + excluded.bytes
; END;
DELETE FROM "sqlite_sequence";
INSERT INTO "sqlite_sequence" VALUES('jobs',5);
COMMIT;
PRAGMA user_version = 4;
