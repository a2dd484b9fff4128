"""Many pictures by a real service."""

from __future__ import annotations

import json
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from sgmethod import Budget
from sgmethod.cli import encoding
from sgmethod.cli import main as cli
from sgmethod.client import Client, encode_many
from sgmethod.client.connection import Connection
from sgmethod.errors import ServerError
from tests.harness.pictures import png
from tests.harness.service import STAND_IN, Service, StartService

pytestmark = pytest.mark.thorough


def test_many_pictures(service: Service, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """By the client and by the command line: the same files as without a server, and none twice."""
    monkeypatch.chdir(tmp_path)
    Path("in").mkdir()
    for number in range(2):
        Path(f"in/{number}.png").write_bytes(png(64, 48, number))
    Path("in/bad.png").write_bytes(b"hello")
    with Client(service.url) as client:
        options = {"budget": Budget("gaussians", 9), "effort": 1}
        first = encode_many(client, sorted(Path("in").iterdir()), "a", resume=True, **options)
        again = encode_many(client, sorted(Path("in").iterdir()), "a", resume=True, **options)
    assert (first.encoded, first.skipped, first.failed) == (2, 0, 1)
    assert (again.encoded, again.skipped, again.failed) == (0, 2, 1)
    names = ["encode", "in/1.png", "in/bad.png", "--output-dir", "b"]
    line = [*names, "--gaussians", "9", "--effort", "1", "--quiet", "--resume"]
    with closing(encoding._client(service.url, True, encoding.MANY_PATIENCE_S)):
        assert cli.main([*line, "--server", service.url]) == cli.main(line) == 1
    assert len(Path("b/manifest.jsonl").read_text().splitlines()) == 4  # another server is another choice
    by_name = {row["name"]: row for row in map(json.loads, Path("a/manifest.jsonl").read_text().splitlines())}
    assert by_name["bad.sg"]["error"].startswith("the server refused: the file is not a PNG")
    data = Path("a/1.sg").read_bytes()
    assert data == Path("b/1.sg").read_bytes()
    assert by_name["1.sg"]["figures"]["bytes"] == len(data)
    assert service.client.get("/jobs").json()["jobs"] == []


def test_a_killed_run_finds_its_jobs_again(
    start_service: StartService, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its pictures were encoded twice."""
    service = start_service(extra=STAND_IN)
    pictures = [(str(number), png(64, 48, number)) for number in range(2)]
    ask = Connection.ask

    def killed(connection: Connection, method: str, path: str, **request: Any) -> Any:
        ask(connection, method, path, **request)
        raise ServerError("the client was killed before it heard of its job")

    with Client(service.url) as client:
        with monkeypatch.context() as patch:
            patch.setattr(Connection, "ask", killed)
            assert encode_many(client, pictures, tmp_path, time_limit_s=0.1).failed == 2
        assert encode_many(client, pictures, tmp_path, resume=True, time_limit_s=0.1).encoded == 2
    assert service.figures()["sgmethod_jobs_accepted_total"] == 2
    assert service.client.get("/jobs").json()["jobs"] == []
