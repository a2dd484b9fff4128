"""What is stored for jobs: how many there are and how many bytes, kept in a table, and the files that they need.

Triggers keep the table `stored`, whoever changes a job. To count the jobs instead would take longer with each of them.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from itertools import islice
from typing import Any

from service.jobs.statements import Database
from service.storage.files import bitstream_key, job_of_key, source_key

BATCH = 500  # keys of one query

OF_OWNER = "SELECT CAST(coalesce(sum(bytes), 0) AS BIGINT) AS bytes FROM stored WHERE owner = coalesce(?, owner)"
BY_STATE = (
    "SELECT state, CAST(sum(jobs) AS BIGINT) AS jobs, CAST(sum(bytes) AS BIGINT) AS bytes FROM stored GROUP BY state"
)


def stored_bytes(db: Database, owner: str | None = None) -> int:
    """Return the bytes stored for the jobs of one owner or of all."""
    return int(db.execute(OF_OWNER, (owner,)).fetchone()["bytes"])


def by_state(db: Database) -> tuple[dict[str, int], int]:
    """Return the number of jobs by state, without those that have had none, and the bytes of all."""
    rows = db.execute(BY_STATE).fetchall()
    return {row["state"]: row["jobs"] for row in rows}, sum(row["bytes"] for row in rows)


def batches(keys: Iterable[str]) -> Iterator[list[str]]:
    """Split storage keys into lists for unneeded()."""
    rest = iter(keys)
    while batch := list(islice(rest, BATCH)):
        yield batch


def unneeded(db: Database, keys: list[str]) -> list[str]:
    """Return the storage keys, of at most BATCH, that no job needs."""
    query = f"SELECT id, state, attempt, result, image_bytes FROM jobs WHERE id IN ({', '.join('?' * len(keys))})"
    needed = {key for row in db.execute(query, [job_of_key(key) for key in keys]).fetchall() for key in _keys_of(row)}
    return [key for key in keys if key not in needed]


def _keys_of(row: Any) -> Iterator[str]:
    if row["image_bytes"]:
        yield source_key(row["id"])
    if row["state"] == "running":  # not published yet
        yield bitstream_key(row["id"], row["attempt"])
    if row["result"]:
        yield json.loads(row["result"])["bitstream_key"]
