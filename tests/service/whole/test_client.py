"""The Python client and `sgmethod encode --server`, one picture or many, against a real service."""

from __future__ import annotations

import json
import re
import sys
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pytest
from PIL import Image

import sgmethod
from sgmethod import Budget
from sgmethod.budget import DEFAULT_BUDGET
from sgmethod.cli import encoding, main as cli
from sgmethod.client import Client, client as client_module, encode_many
from sgmethod.client.connection import Connection
from sgmethod.errors import ServerError
from sgmethod.trace import TracePoint
from tests.support.data import PICTURE, ROOT
from tests.support.pictures import SMALL, png, saved
from tests.support.processes import Outcome, run, wait_until
from tests.support.profiles import OTHER
from tests.support.service import FAKE_CODEC, SMALL_QUEUE, Service, StartService, keys_of


def test_an_encode(service: Service) -> None:
    """One request brings the file, unless somebody wants to see progress. The client cleans up behind itself."""
    before = watches(service), asked(service, "/bitstreams/{job_id}.sg")
    with Client(service.url) as client:
        encoded = client.encode(SMALL, Budget("bpp", 2), time_limit_s=0.5)
        assert encoded.trace
        with pytest.raises(ServerError, match="truncated"):
            client.encode(SMALL[: len(SMALL) // 2], Budget("bpp", 2))
        assert (watches(service) - 1, asked(service, "/bitstreams/{job_id}.sg")) == before
        seen: list[TracePoint] = []
        followed = client.encode(SMALL, Budget("bpp", 2), time_limit_s=0.5, on_progress=seen.append)
    assert followed.trace == seen
    for each in (encoded, followed):
        assert sgmethod.decode(each.data).shape == (48, 64, 3)
        assert each.figures["bytes"] == len(each.data)
    assert service.client.get("/jobs").json()["jobs"] == []


def test_a_file_that_came_out_badly(service: Service) -> None:
    """The job says so, as sgmethod.Stats does."""
    with Client(service.url) as client:
        job_id = client.submit(SMALL, Budget("bytes", 13))
        result = client.wait(job_id)["result"]
        client.remove(job_id)
    (warning,) = result["warnings"]
    assert warning.startswith("the file contains only a background")
    assert (result["source_bytes"], result["psnr_missed_db"]) == (len(SMALL), None)


@pytest.mark.thorough
def test_what_is_dropped_is_noted(service: Service) -> None:
    glass = saved(Image.new("RGBA", (64, 48), (200, 80, 60, 100)))
    with Client(service.url) as client:
        kept = client.encode(glass, Budget("bytes", 200), time_limit_s=0.5)
        laid = client.encode(glass, Budget("gaussians", 4), OTHER, time_limit_s=0.5)
    assert (kept.notes, laid.notes) == ([], ["transparency is composited over white"])
    assert "notes" not in laid.figures


@pytest.mark.thorough
def test_what_is_not_done_in_one_request_is_waited_for(web: Service, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(client_module, "WAIT_S", 1)
    before = watches(web)
    with Client(web.url) as client, ThreadPoolExecutor(1) as pool:
        encode = pool.submit(client.encode, SMALL, Budget("bpp", 2))
        wait_until(lambda: watches(web) > before)
        web.publish(web.client.get("/jobs?limit=1").json()["jobs"][0]["id"], PICTURE)
        assert encode.result().data == PICTURE


def test_a_job_that_somebody_removes(web: Service) -> None:
    before = watches(web)
    with Client(web.url) as client, ThreadPoolExecutor(1) as pool:
        job_id = client.submit(SMALL, Budget("bpp", 1))
        wait = pool.submit(client.wait, job_id)
        wait_until(lambda: watches(web) > before)
        web.client.delete(f"/jobs/{job_id}")
        with pytest.raises(ServerError, match="no such job"):
            wait.result()


def watches(web: Service) -> float:
    """How often clients have looked after their jobs."""
    return asked(web, "/jobs/{job_id}")


def asked(web: Service, route: str) -> float:
    """How often it was, with success."""
    return web.figures().get(f'sgmethod_requests_total{{method="GET",route="{route}",status="200"}}', 0)


def test_paths_are_taken_as_encode_takes_them(web: Service, tmp_path: Path) -> None:
    picture, file = tmp_path / "photo.png", tmp_path / "photo.sg"
    picture.write_bytes(SMALL)
    file.write_bytes(PICTURE)
    with Client(web.url) as client:
        sizes = {client.job(client.submit(image))["image"]["bytes"] for image in (picture, str(picture), SMALL)}
        assert sizes == {len(SMALL)}
        with pytest.raises(ServerError, match="not a PNG"):
            client.encode(file)
        assert client.decode(file) == client.decode(str(file)) == client.decode(PICTURE)
        with pytest.raises(FileNotFoundError):
            client.submit("missing.png")
        with pytest.raises(ServerError, match="path or bytes, not int"):
            client.submit(7)  # type: ignore[arg-type]


@pytest.mark.thorough
def test_a_full_queue_is_waited_for(empty: Service) -> None:
    first, *_ = [empty.accepted() for _ in range(SMALL_QUEUE)]
    with Client(empty.url, patience_s=0) as hasty, pytest.raises(ServerError, match="jobs waiting"):
        hasty.submit(SMALL, Budget("bpp", 1))
    messages: list[str] = []

    def make_room(message: str) -> None:
        messages.append(message)
        empty.client.delete(f"/jobs/{first}")

    with Client(empty.url, patience_s=60, on_retry=make_room) as patient:
        assert patient.submit(SMALL, Budget("bpp", 1)) != first
    assert "jobs waiting" in messages[0]


@pytest.mark.thorough
def test_a_service_that_restarts_meanwhile(start_service: StartService) -> None:
    web = start_service("web")
    messages: list[str] = []
    with Client(web.url, on_retry=messages.append) as client, ThreadPoolExecutor(1) as pool:
        job_id = client.submit(SMALL, Budget("bpp", 2))
        wait = pool.submit(client.wait, job_id)
        wait_until(lambda: watches(web))
        web.environment["SG_PORT"] = web.url.rpartition(":")[2]
        web.stop()
        wait_until(lambda: messages)
        web.start()
        web.publish(job_id, PICTURE)
        assert wait.result()["state"] == "done"
    assert messages
    assert all("trying again in" in text for text in messages)


def test_the_command_line(start_service: StartService, tmp_path: Path) -> None:
    service = start_service(api_keys=keys_of("ann"), extra=FAKE_CODEC)
    (tmp_path / "in.png").write_bytes(SMALL)

    def encode(*arguments: object, key: str = "ann") -> Outcome:
        command = [sys.executable, "-m", "sgmethod", "encode", "in.png", "out.sg", "--server", service.url]
        return run(*command, "--time-limit", 1, *arguments, folder=tmp_path, SG_API_KEY=key, PYTHONPATH=ROOT)

    done = encode("--bpp", 2, "--json", "--trace", "trace.json")
    assert done.status == 0
    assert re.fullmatch(
        r"sgmethod: warning: in\.png: the service was busy: .*, and its time limit cut it short\n", done.stderr
    )
    figures = json.loads(done.stdout)
    data = (tmp_path / "out.sg").read_bytes()
    assert figures["bytes"] == len(data)
    assert sgmethod.info(data).width == 64
    trace = json.loads((tmp_path / "trace.json").read_text())
    assert trace["stats"] == figures
    assert trace["trace"]

    (tmp_path / "out.sg").unlink()
    refused = encode(key="wrong")
    assert refused.status == 2
    assert "unknown API key; set SG_API_KEY" in refused.stderr
    assert refused.stderr.count("\n") == 1
    assert not (tmp_path / "out.sg").exists()


@pytest.mark.thorough
def test_all_that_a_client_may_ask(start_service: StartService) -> None:
    web = start_service("web", link_secret="s" * 32)
    with Client(web.url) as client:
        first = client.submit(SMALL, Budget("bpp", 2), OTHER, time_limit_s=0.5, priority="bulk")
        second = client.submit(SMALL, priority="bulk")  # or it would be claimed first
        assert [client.job(first)[name] for name in ("profile", "time_limit_s", "priority")] == [OTHER, 0.5, "bulk"]
        web.publish(first, PICTURE)
        assert client.wait(first)["state"] == "done"
        assert [job["id"] for job in client.jobs()] == [second, first]
        assert [job["id"] for job in client.jobs("done")] == [first]
        assert next(client.jobs("queued"))["budget"] == asdict(DEFAULT_BUDGET)
        assert client.decode(PICTURE, "webp", width=32) == client.picture(first, "webp", width=32)
        assert client.picture(first, scale=0.5, region="0,0,40,40") != client.picture(first)
        assert client.bitstream(first) == PICTURE
        assert web.client.get(client.links(first, 60)["bitstream_url"]).content == PICTURE
        with pytest.raises(ServerError, match=r"expires_s.*604800"):
            client.links(first, 10**9)
        client.remove(first)
        for ask in (client.job, client.wait):
            with pytest.raises(ServerError, match="no such job"):
                ask(first)


@pytest.mark.thorough
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


@pytest.mark.thorough
def test_a_killed_run_finds_its_jobs_again(
    start_service: StartService, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its pictures were encoded twice."""
    service = start_service(extra=FAKE_CODEC)
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
    assert service.log.read_text().count(": attempt 1 of worker") == 2
    assert service.client.get("/jobs").json()["jobs"] == []
