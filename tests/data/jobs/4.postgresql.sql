SET statement_timeout = 0;
SET lock_timeout = 0;
SET idle_in_transaction_session_timeout = 0;
SET client_encoding = 'UTF8';
SET standard_conforming_strings = on;
SELECT pg_catalog.set_config('search_path', '', false);
SET check_function_bodies = false;
SET xmloption = content;
SET client_min_messages = warning;
SET row_security = off;
CREATE SCHEMA sgmethod;
CREATE FUNCTION sgmethod.count_delete() RETURNS trigger
    LANGUAGE plpgsql
    AS $$ BEGIN
    INSERT INTO sgmethod.stored
    SELECT owner, state, sum(jobs), sum(bytes) FROM (SELECT owner, state, -1 AS jobs, -image_bytes - file_bytes AS bytes FROM removed) AS changes
    GROUP BY owner, state HAVING sum(jobs) <> 0 OR sum(bytes) <> 0 ORDER BY owner, state
    ON CONFLICT (owner, state) DO UPDATE SET jobs = stored.jobs + excluded.jobs, bytes = stored.bytes + excluded.bytes;
    RETURN NULL;
END $$;
CREATE FUNCTION sgmethod.count_insert() RETURNS trigger
    LANGUAGE plpgsql
    AS $$ BEGIN
    INSERT INTO sgmethod.stored
    SELECT owner, state, sum(jobs), sum(bytes) FROM (SELECT owner, state, 1 AS jobs, image_bytes + file_bytes AS bytes FROM added) AS changes
    GROUP BY owner, state HAVING sum(jobs) <> 0 OR sum(bytes) <> 0 ORDER BY owner, state
    ON CONFLICT (owner, state) DO UPDATE SET jobs = stored.jobs + excluded.jobs, bytes = stored.bytes + excluded.bytes;
    RETURN NULL;
END $$;
CREATE FUNCTION sgmethod.count_update() RETURNS trigger
    LANGUAGE plpgsql
    AS $$ BEGIN
    INSERT INTO sgmethod.stored
    SELECT owner, state, sum(jobs), sum(bytes) FROM (SELECT owner, state, 1 AS jobs, image_bytes + file_bytes AS bytes FROM added UNION ALL SELECT owner, state, -1 AS jobs, -image_bytes - file_bytes AS bytes FROM removed) AS changes
    GROUP BY owner, state HAVING sum(jobs) <> 0 OR sum(bytes) <> 0 ORDER BY owner, state
    ON CONFLICT (owner, state) DO UPDATE SET jobs = stored.jobs + excluded.jobs, bytes = stored.bytes + excluded.bytes;
    RETURN NULL;
END $$;
CREATE FUNCTION sgmethod.epoch() RETURNS double precision
    LANGUAGE sql
    AS $$SELECT extract(epoch FROM clock_timestamp())::DOUBLE PRECISION$$;
SET default_tablespace = '';
SET default_table_access_method = heap;
CREATE TABLE sgmethod.deliveries (
    job text NOT NULL,
    address text NOT NULL,
    body text NOT NULL,
    ended_at double precision NOT NULL,
    due_at double precision NOT NULL
);
CREATE TABLE sgmethod.jobs (
    number bigint NOT NULL,
    id text NOT NULL,
    owner text DEFAULT ''::text NOT NULL,
    priority text DEFAULT 'interactive'::text NOT NULL,
    state text DEFAULT 'queued'::text NOT NULL,
    idempotency_key text,
    fingerprint text NOT NULL,
    request text NOT NULL,
    image text NOT NULL,
    attempt integer DEFAULT 0 NOT NULL,
    crashes integer DEFAULT 0 NOT NULL,
    worker text,
    lease_until double precision,
    created_at double precision NOT NULL,
    started_at double precision,
    finished_at double precision,
    result text,
    error text,
    image_bytes bigint NOT NULL,
    file_bytes bigint DEFAULT 0 NOT NULL,
    stopped integer DEFAULT 0 NOT NULL,
    losses integer DEFAULT 0 NOT NULL,
    CONSTRAINT jobs_check CHECK (((state = 'done'::text) = (result IS NOT NULL))),
    CONSTRAINT jobs_priority_check CHECK ((priority = ANY (ARRAY['interactive'::text, 'bulk'::text]))),
    CONSTRAINT jobs_state_check CHECK ((state = ANY (ARRAY['queued'::text, 'running'::text, 'done'::text, 'failed'::text])))
);
ALTER TABLE sgmethod.jobs ALTER COLUMN number ADD GENERATED ALWAYS AS IDENTITY (
    SEQUENCE NAME sgmethod.jobs_number_seq
    START WITH 1
    INCREMENT BY 1
    NO MINVALUE
    NO MAXVALUE
    CACHE 1
);
CREATE TABLE sgmethod.served (
    owner text NOT NULL,
    at double precision NOT NULL
);
CREATE TABLE sgmethod.stored (
    owner text NOT NULL,
    state text NOT NULL,
    jobs bigint NOT NULL,
    bytes bigint NOT NULL
);
CREATE TABLE sgmethod.totals (
    name text NOT NULL,
    amount double precision NOT NULL
);
CREATE TABLE sgmethod.trace (
    job bigint NOT NULL,
    place integer NOT NULL,
    point text NOT NULL
);
CREATE TABLE sgmethod.version (
    part text NOT NULL,
    version text NOT NULL
);
CREATE TABLE sgmethod.workers (
    name text NOT NULL,
    seen_at double precision NOT NULL
);
INSERT INTO sgmethod.deliveries VALUES ('aaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaa', 'https://app.example/pictures', '{"type": "job.done", "timestamp": "2026-11-30T02:50:49.695125+00:00", "data": {"id": "aaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaa", "key": "ann", "state": "done", "attempt": 1, "error": null, "bytes": 100, "sha256": "abababababababababababababababababababababababababababababababab"}}', 1796007049.69671, 1796007049.696715);
INSERT INTO sgmethod.deliveries VALUES ('bbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbb', 'https://app.example/pictures', '{"type": "job.failed", "timestamp": "2026-11-30T02:50:49.717593+00:00", "data": {"id": "bbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbb", "key": null, "state": "failed", "attempt": 1, "error": {"code": "refused", "detail": "no"}, "bytes": null, "sha256": null}}', 1796007049.722172, 1796007049.722179);
INSERT INTO sgmethod.jobs OVERRIDING SYSTEM VALUE VALUES (1, 'aaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaa', 'ann', 'interactive', 'done', 'the key', 'f', '{"budget_kind": "bpp", "budget_value": 1.0, "profile": "rd", "time_limit_s": 60.0, "tune": "psnr", "effort": 5}', '{"format": "PNG", "width": 64, "height": 48, "size_bytes": 1000}', 1, 0, 'w', 1796007109.683676, 1796007049.663009, 1796007049.676699, 1796007049.695125, '{"bitstream_key": "bitstreams/aaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaa.1.sg", "sha256": "abababababababababababababababababababababababababababababababab", "stats": {"bytes": 100, "psnr": null}}', NULL, 1000, 100, 0, 0);
INSERT INTO sgmethod.jobs OVERRIDING SYSTEM VALUE VALUES (2, 'bbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbb', '', 'interactive', 'failed', NULL, 'f', '{"budget_kind": "bpp", "budget_value": 1.0, "profile": "rd", "time_limit_s": 60.0, "tune": "psnr", "effort": 5}', '{"format": "PNG", "width": 64, "height": 48, "size_bytes": 1000}', 1, 0, 'w', 1796007109.708625, 1796007049.703606, 1796007049.708632, 1796007049.717593, NULL, '{"code": "refused", "detail": "no"}', 1000, 0, 0, 0);
INSERT INTO sgmethod.jobs OVERRIDING SYSTEM VALUE VALUES (3, 'cccccccccccccccccccccccccccccccc', 'bob', 'interactive', 'running', NULL, 'f', '{"budget_kind": "bpp", "budget_value": 1.0, "profile": "rd", "time_limit_s": 60.0, "tune": "psnr", "effort": 5}', '{"format": "PNG", "width": 64, "height": 48, "size_bytes": 1000}', 1, 0, 'w', 1796007109.73909, 1796007049.723891, 1796007049.728847, NULL, NULL, NULL, 1000, 0, 0, 0);
INSERT INTO sgmethod.jobs OVERRIDING SYSTEM VALUE VALUES (4, 'dddddddddddddddddddddddddddddddd', '', 'interactive', 'queued', NULL, 'f', '{"budget_kind": "bpp", "budget_value": 1.0, "profile": "rd", "time_limit_s": 60.0, "tune": "psnr", "effort": 5}', '{"format": "PNG", "width": 64, "height": 48, "size_bytes": 1000}', 1, 0, 'w', 4e9, 1796007049.74139, NULL, NULL, NULL, NULL, 1000, 0, 0, 0);
INSERT INTO sgmethod.jobs OVERRIDING SYSTEM VALUE VALUES (5, 'eeeeeeeeeeeeeeeeeeeeeeeeeeeeeeee', 'ann', 'bulk', 'queued', NULL, 'f', '{"budget_kind": "bpp", "budget_value": 1.0, "profile": "rd", "time_limit_s": 60.0, "tune": "psnr", "effort": 5}', '{"format": "PNG", "width": 64, "height": 48, "size_bytes": 1000}', 0, 0, NULL, NULL, 1796007049.751474, NULL, NULL, NULL, NULL, 1000, 0, 0, 0);
INSERT INTO sgmethod.served VALUES ('ann', 1796007049.676699);
INSERT INTO sgmethod.served VALUES ('', 1796007049.708632);
INSERT INTO sgmethod.served VALUES ('bob', 1796007049.728847);
INSERT INTO sgmethod.stored VALUES ('ann', 'done', 1, 1100);
INSERT INTO sgmethod.stored VALUES ('ann', 'running', 0, 0);
INSERT INTO sgmethod.stored VALUES ('', 'running', 0, 0);
INSERT INTO sgmethod.stored VALUES ('', 'failed', 1, 1000);
INSERT INTO sgmethod.stored VALUES ('bob', 'queued', 0, 0);
INSERT INTO sgmethod.stored VALUES ('bob', 'running', 1, 1000);
INSERT INTO sgmethod.stored VALUES ('', 'queued', 1, 1000);
INSERT INTO sgmethod.stored VALUES ('ann', 'queued', 1, 1000);
INSERT INTO sgmethod.totals VALUES ('finished', 1);
INSERT INTO sgmethod.totals VALUES ('encode_seconds', 0.018426179885864258);
INSERT INTO sgmethod.totals VALUES ('failed', 1);
INSERT INTO sgmethod.trace VALUES (1, 0, '{"step": 1}');
INSERT INTO sgmethod.trace VALUES (3, 0, '{"step": 1}');
INSERT INTO sgmethod.trace VALUES (3, 1, '{"step": 2}');
INSERT INTO sgmethod.version VALUES ('jobs', '4');
INSERT INTO sgmethod.workers VALUES ('w', 1796007049.63843);
SELECT pg_catalog.setval('sgmethod.jobs_number_seq', 5, true);
ALTER TABLE ONLY sgmethod.deliveries
    ADD CONSTRAINT deliveries_pkey PRIMARY KEY (job, address);
ALTER TABLE ONLY sgmethod.jobs
    ADD CONSTRAINT jobs_id_key UNIQUE (id);
ALTER TABLE ONLY sgmethod.jobs
    ADD CONSTRAINT jobs_owner_idempotency_key_key UNIQUE (owner, idempotency_key);
ALTER TABLE ONLY sgmethod.jobs
    ADD CONSTRAINT jobs_pkey PRIMARY KEY (number);
ALTER TABLE ONLY sgmethod.served
    ADD CONSTRAINT served_pkey PRIMARY KEY (owner);
ALTER TABLE ONLY sgmethod.stored
    ADD CONSTRAINT stored_pkey PRIMARY KEY (owner, state);
ALTER TABLE ONLY sgmethod.totals
    ADD CONSTRAINT totals_pkey PRIMARY KEY (name);
ALTER TABLE ONLY sgmethod.trace
    ADD CONSTRAINT trace_pkey PRIMARY KEY (job, place);
ALTER TABLE ONLY sgmethod.version
    ADD CONSTRAINT version_pkey PRIMARY KEY (part);
ALTER TABLE ONLY sgmethod.workers
    ADD CONSTRAINT workers_pkey PRIMARY KEY (name);
CREATE INDEX deliveries_by_time ON sgmethod.deliveries USING btree (address, due_at);
CREATE INDEX jobs_by_owner ON sgmethod.jobs USING btree (owner, number);
CREATE INDEX jobs_by_state ON sgmethod.jobs USING btree (state, number);
CREATE TRIGGER count_delete AFTER DELETE ON sgmethod.jobs REFERENCING OLD TABLE AS removed FOR EACH STATEMENT EXECUTE FUNCTION sgmethod.count_delete();
CREATE TRIGGER count_insert AFTER INSERT ON sgmethod.jobs REFERENCING NEW TABLE AS added FOR EACH STATEMENT EXECUTE FUNCTION sgmethod.count_insert();
CREATE TRIGGER count_update AFTER UPDATE ON sgmethod.jobs REFERENCING OLD TABLE AS removed NEW TABLE AS added FOR EACH STATEMENT EXECUTE FUNCTION sgmethod.count_update();
ALTER TABLE ONLY sgmethod.trace
    ADD CONSTRAINT trace_job_fkey FOREIGN KEY (job) REFERENCES sgmethod.jobs(number) ON DELETE CASCADE;
