"""The operator's commands."""

from __future__ import annotations

import json
import signal
import socket
import sys
from contextlib import closing
from pathlib import Path

import pytest

from service import checking
from service.api.encode import EncodeQuery
from service.api.problems import ProblemError
from service.commands import _for_whom, _where
from service.opening import open_job_table
from service.settings import Settings
from sgmethod import machine
from tests.support.job_table import IMAGE, REFUSED, claimed, state, submitted
from tests.support.postgres_server import PostgresServer
from tests.support.processes import Outcome, run
from tests.support.profiles import OTHER
from tests.support.service import FAKE_CODEC, RunCommand


def verdicts(result: Outcome) -> dict[str, str]:
    lines = (line.split(maxsplit=1) for line in result.stdout.splitlines())
    return {rest.partition(":")[0]: word for word, rest in lines}


def test_check_of_a_sound_service(run_command: RunCommand, tmp_path: Path, database_url: str) -> None:
    result = run_command("check", data_dir=tmp_path / "data", database_url=database_url)
    names = ("settings", "database", "storage", "free disk", "kernels", "sandbox")
    assert verdicts(result) == dict.fromkeys(names, "ok"), result
    assert result.status == 0
    assert list((tmp_path / "data" / "unfinished").iterdir()) == []
    assert "0 queued, 0 running" in result.stdout


@pytest.mark.parametrize(
    ("memory", "settings", "words"),
    [
        (512 << 20, {}, "an encode has 346,870,912 bytes of memory"),
        (1 << 30, {}, ""),
        (10 << 30, {"workers": 8}, ""),  # as in each of the containers of docs/compose.scale.yaml
        (4 << 30, {"workers": 8}, "lower SG_WORKERS"),
        (1 << 30, {"job_memory_bytes": 1 << 30}, "the system may kill an encode"),
    ],
)
def test_check_compares_the_memory_with_what_encodes_need(
    monkeypatch: pytest.MonkeyPatch, memory: int, settings: dict[str, int], words: str
) -> None:
    """It warned of what encodes were allowed, even of other containers, and passed 512 MB without a word."""
    monkeypatch.setattr(machine, "memory", lambda: memory)
    found = checking._settings(Settings(**{"workers": 1, **settings}))  # type: ignore[arg-type]
    assert ("memory" in found) == bool(words)
    assert words in found


def test_check_tries_the_sandbox(run_command: RunCommand, tmp_path: Path) -> None:
    """Its layers may all be there, and still it may do no task."""
    (tmp_path / "sitecustomize.py").write_text(
        "import os, sys\nif 'service.sandbox.server' in sys.orig_argv:\n    os.fork = lambda: open('/nowhere')\n"
    )
    result = run_command("check", data_dir=tmp_path / "data", PYTHONPATH=tmp_path)
    assert (result.status, verdicts(result)["sandbox"]) == (1, "FAILED"), result


def test_a_parent_that_ignores_the_ends_of_children(run_command: RunCommand, tmp_path: Path) -> None:
    """As some launchers do, and children inherit it: the system then keeps no status of theirs."""
    before = signal.signal(signal.SIGCHLD, signal.SIG_IGN)
    try:
        result = run_command("check", data_dir=tmp_path)
    finally:
        signal.signal(signal.SIGCHLD, before)
    assert (result.status, verdicts(result)["sandbox"]) == (0, "ok"), result


def test_what_needs_torch(run_command: RunCommand, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """One profile does; the service does not."""
    other = EncodeQuery(profile=OTHER)
    assert other.request(IMAGE, 60).profile == OTHER
    monkeypatch.setitem(sys.modules, "torch", None)  # as if it were not installed
    result = run_command("check", data_dir=tmp_path)
    assert verdicts(result)["kernels"] == "ok"
    assert f"profile {OTHER} needs PyTorch" in result.stdout
    assert EncodeQuery().request(IMAGE, 60).profile == "rd"
    with pytest.raises(ProblemError, match=f"profile {OTHER} needs PyTorch") as refusal:
        other.request(IMAGE, 60)
    assert refusal.value.status == 422


def test_check_names_what_is_wrong(run_command: RunCommand, tmp_path: Path) -> None:
    """A password is not printed, even where the address cannot be read."""
    for url in ("postgresql://someone:secret@127.0.0.1:1/none", "postgresql://someone:secret%@127.0.0.1/none"):
        result = run_command("check", data_dir=tmp_path / "data", database_url=url, max_upload_bytes=2**50)
        right = dict.fromkeys(("settings", "storage", "kernels", "sandbox"), "ok")
        assert verdicts(result) == {**right, "database": "FAILED", "free disk": "FAILED"}
        assert result.status == 1
        assert "secret" not in result.stdout + result.stderr
    assert "SG_DATABASE_URL cannot be read" in result.stdout


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({}, "data in {}"),
        ({"database_url": "postgresql://u:secret@db/x"}, "jobs in PostgreSQL, images and bitstreams in {}"),
        ({"storage_url": "s3://pictures/sg"}, "jobs in {}, images and bitstreams in s3://pictures/sg"),
    ],
)
def test_where_everything_is_kept(tmp_path: Path, settings: dict[str, str], words: str) -> None:
    """It printed that data were in a folder, where a database and a bucket held them all."""
    assert _where(Settings(data_dir=tmp_path, **settings)) == words.format(tmp_path)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("host", "settings", "words"),
    [
        ("127.0.0.1", {}, "for this machine alone, without API keys"),
        ("127.0.0.1", {"host_names": "pictures.example"}, "open to everyone who can reach it"),
        ("0.0.0.0", {"host_names": "pictures.example"}, "open to everyone who can reach it"),
    ],
)
def test_for_whom_the_service_is(tmp_path: Path, host: str, settings: dict[str, str], words: str) -> None:
    """It printed on 127.0.0.1 that it was open to everyone. With names, a proxy passes others on."""
    with socket.create_server((host, 0)) as listener:
        assert _for_whom(Settings(data_dir=tmp_path, **settings), listener) == words  # type: ignore[arg-type]


def test_a_database_out_of_reach_is_one_clear_line(
    run_command: RunCommand, tmp_path: Path, postgres: PostgresServer
) -> None:
    for command in ("serve", "web", "worker"):
        result = run_command(command, data_dir=tmp_path, database_url=postgres.url("there_is_none"), port=0)
        assert (result.status, result.stdout) == (1, "")  # and no address is printed where nothing answers
        (line,) = [text for text in result.stderr.splitlines() if "INFO" not in text]
        assert "PostgreSQL: " in line
        assert "does not exist" in line


def test_retry_puts_failed_jobs_back(run_command: RunCommand, tmp_path: Path, database_url: str) -> None:
    settings = {"data_dir": tmp_path, "database_url": database_url}
    with closing(open_job_table(Settings(**settings))) as table:  # type: ignore[arg-type]
        failed, waits = submitted(table), submitted(table)
        table.fail(claimed(table), REFUSED)
        again = run_command("retry", failed, **settings)
        assert (again.status, again.stdout, again.stderr) == (0, f"{failed}: queued again\n", "")
        assert state(table, failed) == "queued"
        assert table.fail(claimed(table), REFUSED)
        some = run_command("retry", waits, "unknown", failed, **settings)
        assert (some.status, some.stdout) == (1, f"{failed}: queued again\n")
        expected = f"{waits}: it is queued, not failed\nunknown: there is no such job in this job table\n"
        assert some.stderr == expected
        assert state(table, failed) == "queued"


@pytest.mark.thorough
def test_chaos_draws_up_a_ledger(tmp_path: Path) -> None:
    """A few jobs and no encodes, to see that the command works; benchmarks/results has the large runs."""
    out = tmp_path / "chaos.json"
    command = [sys.executable, "-m", "benchmarks.service", "chaos", "--jobs", 3, "--seed", 3, "--out", out]
    result = run(*command, **FAKE_CODEC)
    assert result.status == 0, result
    (table,) = json.loads(out.read_text())["rows"]
    row = {name: value for name, (value,) in table.items()}
    assert row["balanced"]
    assert row["ledger"]["accepted"] == 3
