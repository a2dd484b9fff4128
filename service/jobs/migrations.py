"""The tables, and numbered changes to them.

A service brings the tables to its version when it opens them, in one transaction, so that jobs outlive an upgrade.
"""

from __future__ import annotations

import logging
from collections.abc import Iterable

from service.errors import JobTableError
from service.jobs.statements import Database

log = logging.getLogger(__name__)

FIRST_VERSION = 9  # that of 1.0.0, whose release candidates had 1 to 8
# The tables of this version, which stay as they are: MIGRATIONS has what came later. {number}: the type of an automatic
# row number, which depends on the database. The table `stored` counts jobs and their bytes by owner and state; each
# database adds triggers that update it.
SCHEMA = """
CREATE TABLE stored (
    owner TEXT NOT NULL,
    state TEXT NOT NULL,
    jobs  BIGINT NOT NULL,
    bytes BIGINT NOT NULL,
    PRIMARY KEY (owner, state)
);
CREATE TABLE workers (
    name    TEXT PRIMARY KEY,
    seen_at DOUBLE PRECISION NOT NULL
);
CREATE TABLE totals (
    name   TEXT PRIMARY KEY,
    amount DOUBLE PRECISION NOT NULL
);
CREATE TABLE jobs (
    number          {number},
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
    losses          INTEGER NOT NULL DEFAULT 0,
    client          TEXT NOT NULL DEFAULT '',
    UNIQUE (owner, idempotency_key)
);
CREATE INDEX jobs_by_state ON jobs (state, number);
CREATE INDEX jobs_by_owner ON jobs (owner, number);
CREATE INDEX queue ON jobs (state, priority, number) WHERE state = 'queued';
CREATE INDEX queue_by_owner ON jobs (owner, priority DESC, number) WHERE state = 'queued';
CREATE INDEX queue_by_client ON jobs (client) WHERE state = 'queued';
CREATE TABLE served (
    owner TEXT PRIMARY KEY,
    at    DOUBLE PRECISION NOT NULL
);
CREATE TABLE trace (
    job   BIGINT NOT NULL REFERENCES jobs (number) ON DELETE CASCADE,
    place INTEGER NOT NULL,
    point TEXT NOT NULL,
    PRIMARY KEY (job, place)
);
INSERT INTO totals VALUES ('made_at', epoch());
"""
# Statements of each later version, in the SQL that both databases share. A released entry never changes. A process of
# the version before may be running, so an entry adds indexes, and columns with a default, and removes nothing. It adds
# no table, at which pg_restore --clean of an older backup would fail when all others are gone.
MIGRATIONS: tuple[tuple[str, ...], ...] = ()
NEWEST_VERSION = FIRST_VERSION + len(MIGRATIONS)


def migrate(db: Database, version: int | None, create: Iterable[str]) -> int | None:
    """Bring the tables to today's version within the caller's transaction, and return it; None if they have it.

    version: that of the tables, None if there are none; create: statements that make those of FIRST_VERSION. Raises
    JobTableError for a version that cannot be brought to today's.
    """
    if version is None:
        for statement in create:
            db.execute(statement)
    elif version < FIRST_VERSION:
        advice = "start with an empty data folder, or an empty database and bucket"
        raise JobTableError(f"the job table has version {version}, that of a release candidate; {advice}")
    elif version > NEWEST_VERSION:
        known = f"this service reads versions {FIRST_VERSION} to {NEWEST_VERSION}"
        raise JobTableError(f"the job table has version {version}, and {known}; install the service that wrote it")
    elif version < NEWEST_VERSION:
        log.info("bringing the job table from version %d to %d", version, NEWEST_VERSION)
    for statements in MIGRATIONS[(version or FIRST_VERSION) - FIRST_VERSION :]:
        for statement in statements:
            db.execute(statement)
    return None if version == NEWEST_VERSION else NEWEST_VERSION
