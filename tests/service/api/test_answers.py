"""What every answer has: an id, a line in the log, a HEAD; what files have: parts, formats, an end."""

from __future__ import annotations

import io
import json
import logging
import re
import select
import shutil
from contextlib import ExitStack
from datetime import datetime, timedelta
from email.utils import parsedate_to_datetime
from pathlib import Path
from typing import Any

import pytest
from PIL import Image

from service import logs
from service.keys import digest
from service.pictures import MEDIA_TYPES
from tests.support.data import PICTURE
from tests.support.pictures import SMALL
from tests.support.processes import TIMEOUT_S, wait_until
from tests.support.service import RunCommand, Service, StartService, assert_problem, bearer, keys_of


@pytest.mark.parametrize(
    ("accept", "kind"),
    [
        ("*/*", "png"),
        ("image/*", "png"),
        ("image/avif,image/webp,image/apng,image/svg+xml,image/*,*/*;q=0.8", "png"),
        ("image/avif,image/webp,*/*;q=0.8", "webp"),
        ("image/jpeg", "jpeg"),
        ("IMAGE/AVIF", "avif"),
        ("image/png;q=0, image/*", "jpeg"),
        ("image/webp;q=x", "webp"),
        ("text/html, image/jpeg;q=.5, *; q=.2, */*; q=.2", "jpeg"),
    ],
)
def test_formats_as_accepted(web: Service, done: str, accept: str, kind: str) -> None:
    for answer in (
        web.client.get(f"/decode/{done}", headers={"Accept": accept}),
        web.client.post("/decode", content=PICTURE, headers={"Accept": accept}),
    ):
        assert answer.headers["content-type"] == f"image/{kind}"
        assert answer.headers["vary"] == "Accept"
        assert Image.open(io.BytesIO(answer.content)).format == kind.upper()


def test_formats_that_are_not_made(web: Service, done: str) -> None:
    assert_problem(web.client.get(f"/decode/{done}", headers={"Accept": "image/gif"}), 406, "image/png")
    assert_problem(web.client.post("/decode", content=PICTURE, headers={"Accept": "text/html"}), 406)
    assert_problem(web.client.post("/decode.gif", content=PICTURE), 404)
    waiting = {"Accept": "image/gif", "Content-Type": "image/png"}
    assert_problem(
        web.client.post("/encode?wait=5", content=b"never read", headers=waiting), 406
    )  # before there is a job


def test_a_region_is_four_numbers(web: Service, done: str) -> None:
    assert_problem(web.client.get(f"/decode/{done}.jpg?region=1,2"), 422, "query.region: give four whole numbers")


@pytest.mark.parametrize(
    "path",
    [
        *("/jobs?offset=1", "/jobs/{}?x=", "/decode/{}.png?wdith=10"),
        *("/decode/{}?wait=1", "/bitstreams/{}.sg?v=1", "/livez?a", "/metrics?a"),
    ],
)
def test_unknown_parameters(web: Service, done: str, path: str) -> None:
    """They were ignored, and the answer kept for a year."""
    assert_problem(web.client.get(path.format(done)), 422, "query")


def test_head_of_everything(web: Service, done: str) -> None:
    paths = web.client.get("/openapi.json").json()["paths"]
    files = [path for path in paths if "get" in paths[path] and not path.endswith("comparison.{kind}")]
    assert len(files) >= 8
    for path in (*files, "/", "/docs", "/openapi.json", "/static/main.js"):
        url = path.format(job_id=done, kind="png")
        head, get = web.client.head(url), web.client.get(url)
        assert (head.status_code, head.content) == (200, b""), url
        assert head.headers["content-type"] == get.headers["content-type"]


def test_browsers_ask_again_for_the_page_and_its_decoder(web: Service) -> None:
    """They kept both for days after an upgrade, and an older decoder cannot read new files."""
    for path in ("/", "/docs", "/static/main.js", "/static/sgmethod/file.js", "/openapi.json"):
        answer, fresh = web.client.get(path), "max-age=10" if path.startswith("/static/") else "no-cache"
        assert (answer.status_code, answer.headers["cache-control"]) == (200, fresh), path
        if etag := answer.headers.get("etag"):
            again = web.client.get(path, headers={"If-None-Match": etag})
            assert (again.status_code, again.headers["cache-control"], again.content) == (304, fresh, b""), path
        else:
            assert path == "/openapi.json"


def test_requests_have_ids_and_lines(start_service: StartService) -> None:
    web = start_service("web", api_keys=keys_of("ann"), link_secret="s" * 32)
    given = web.client.get("/docs", headers={"X-Request-Id": "mine-1"})
    assert given.headers["x-request-id"] == "mine-1"
    forged = web.client.get("/jobs", headers={"X-Request-Id": 'a"b c'})
    assert re.fullmatch("[0-9a-f]{16}", forged.headers["x-request-id"])
    assert forged.status_code == 401
    web.client.get("/jobs?signature=not-for-the-log", headers=bearer("ann"))

    def lines() -> list[tuple[str, str]] | None:
        found = re.findall(r" access: (.*) \[(.*)\]$", web.log.read_text(), re.MULTILINE)
        return found if len(found) >= 3 else None

    by_id = {name: words for words, name in wait_until(lines) or ()}
    assert re.fullmatch(r"GET '/docs' 200 [\d.]+ ms \d+ bytes, 127.0.0.1", by_id["mine-1"])
    assert re.fullmatch(r"GET '/jobs' 401 .*, 127.0.0.1 key", by_id[forged.headers["x-request-id"]])
    assert any(", 127.0.0.1 key ann" in words for words in by_id.values())
    assert "not-for-the-log" not in web.log.read_text()
    assert "Bearer" not in web.log.read_text()


def test_logs_as_json(start_service: StartService) -> None:
    """For programs: members instead of words, a time with its zone, and without what is asked all the time. Lines of
    the start, too.
    """
    web = start_service("web", api_keys=keys_of("ann"), log_format="json", misspelt=1)
    done = web.published(PICTURE, "ann")
    for path in ("/livez", "/metrics", f"/jobs/{done}", f"/decode/{done}.png", f"/jobs/{done[::-1]}"):
        web.client.get(path, headers={**bearer("ann"), "X-Request-Id": "of-this"})

    def lines() -> list[dict[str, Any]] | None:
        found = [json.loads(line) for line in web.log.read_text().splitlines()]
        ours = [line for line in found if line["logger"] == "access"]
        return ours if len(ours) >= 2 else None

    first, second = wait_until(lines) or []
    assert datetime.fromisoformat(first["time"]).utcoffset() == timedelta(0)
    assert (first["level"], first["request_id"], first["key"]) == ("INFO", "of-this", "ann")
    assert (first["method"], first["path"], first["status"]) == ("GET", f"/decode/{done}.png", 200)
    assert (first["address"], first["bytes"] > 100) == ("127.0.0.1", True)
    assert (second["status"], second["refusal"]) == (404, "unknown")
    start = [json.loads(line) for line in web.log.read_text().splitlines()[:10]]
    told = {line["level"]: line["message"] for line in start if "service.commands" in line["logger"]}
    assert "sgmethod service on http" in told["INFO"]


def test_a_level_of_logs(run_command: RunCommand, tmp_path: Path) -> None:
    """Ours is chosen; libraries are never asked for more than information."""
    for level, expected in (("debug", (10, 20)), ("error", (40, 40))):
        run_command("check", data_dir=tmp_path, log_level=level)
        names = ("service.api.gate", "python_multipart")
        assert tuple(logging.getLogger(name).getEffectiveLevel() for name in names) == expected
    logs.set_up_logging()


@pytest.mark.thorough
def test_finished_jobs_say_when_they_go(start_service: StartService) -> None:
    web = start_service("web", retention_s=1000)
    done = web.published(PICTURE)
    job = web.job(done)
    assert job["expires_at"] > job["finished_at"]
    expires = {web.client.get(job[url]).headers["expires"] for url in ("decode_url", "bitstream_url")}
    assert {parsedate_to_datetime(text).isoformat()[:19] for text in expires} == {job["expires_at"][:19]}
    assert web.job(web.accepted())["expires_at"] is None
    forever = start_service("web", retention_s=0)
    done = forever.published(PICTURE)
    assert forever.job(done)["expires_at"] is None
    assert "expires" not in forever.client.get(f"/decode/{done}.png").headers


@pytest.mark.thorough
def test_keys_are_read_anew(start_service: StartService, tmp_path: Path) -> None:
    file = tmp_path / "keys"
    file.write_text(f"ann:{digest('old')}\n")
    web = start_service("web", api_keys_file=file)

    def status(key: str) -> int:
        return web.client.get("/jobs", headers=bearer(key)).status_code

    assert (status("old"), status("new")) == (200, 401)
    file.write_text(f"bob:{digest('new')}\n")
    wait_until(lambda: status("new") == 200)
    assert status("old") == 401
    for damaged in ("nonsense", ""):
        file.write_text(damaged)
        wait_until(lambda: "kept the previous API keys" in web.log.read_text())
        assert status("new") == 200
        assert web.client.get("/jobs").status_code == 401  # never open to all
    file.unlink()
    file.write_text(f"cat:{digest('third')}\n")
    wait_until(lambda: status("third") == 200)


def test_a_full_disk_shows_and_takes_no_jobs(start_service: StartService) -> None:
    web = start_service("web", max_upload_bytes=2**60)
    assert_problem(web.client.get("/readyz"), 503, "disk is almost full")
    assert web.client.get("/livez").status_code == 200
    answer = web.post()
    assert_problem(answer, 503, "disk is full")
    assert answer.headers["retry-after"]
    assert web.files() == []
    done = web.published(PICTURE)
    assert web.client.get(f"/decode/{done}.png").status_code == 200
    assert web.figures()["sgmethod_free_bytes"] > 0


def test_unfinished_uploads_leave_room_on_the_disk(start_service: StartService, tmp_path: Path) -> None:
    """Space was checked once a body was there: forty that never ended filled the disk of the job table."""
    size = shutil.disk_usage(tmp_path).free // 9  # so that two fit, each twice, beside the room for four
    web = start_service("web", max_upload_bytes=size)
    head = b"POST /encode HTTP/1.1\r\nHost: localhost\r\nContent-Type: image/png\r\n"
    sizes = b"Content-Length: %d" % size, b"Transfer-Encoding: chunked", b"Content-Length: %025d" % size
    with ExitStack() as stack:
        clients = [stack.enter_context(web.connect()) for _ in sizes]
        for client, announced in zip(clients, sizes, strict=True):
            client.sendall(head + announced + b"\r\n\r\n")
        ((refused,), _, _) = select.select(clients, [], [], TIMEOUT_S)
        answer = b""
        while not answer.endswith(b"}"):  # its head may come by itself
            answer += refused.recv(65536)
        assert answer.startswith(b"HTTP/1.1 503")
        assert b"retry-after: " in answer
        assert b"the disk has no room for this upload" in answer
        assert web.post().status_code == 202  # a small one stays in memory
        assert web.client.get("/readyz").status_code == 200

    def has_room() -> bool:
        with web.connect() as client:
            client.sendall(head + sizes[0] + b"\r\n\r\n")
            return not select.select([client], [], [], 0.5)[0]

    wait_until(has_room)


def test_quotas_of_one_key_and_of_all(start_service: StartService) -> None:
    size = len(SMALL)
    keys = keys_of("ann", "bob", "cat")
    web = start_service("web", api_keys=keys, quota_bytes=2 * size, quota_bytes_per_key=size)
    for name, status in (("ann", 202), ("ann", 429), ("bob", 202), ("cat", 429)):
        answer = web.client.post("/encode", content=SMALL, headers={**bearer(name), "Content-Type": "image/png"})
        assert answer.status_code == status
        if status == 429:
            assert_problem(answer, 429, "has reached its storage quota")
    assert len(web.files()) == 2


def test_pages_of_other_origins(start_service: StartService, web: Service) -> None:
    """None is allowed unasked. The browser asks first, without a key."""
    answer = web.client.get("/livez", headers={"Origin": "https://a.example"})
    assert "access-control-allow-origin" not in answer.headers
    web = start_service("web", api_keys=keys_of("ann"), cors_origins="https://a.example, https://b.example")
    headers = "authorization, content-type, if-none-match, traceparent, tracestate"
    ask = {"Access-Control-Request-Method": "POST", "Access-Control-Request-Headers": headers}
    for origin, allowed in (("https://b.example", True), ("https://c.example", False)):
        answer = web.client.options("/encode", headers={"Origin": origin, **ask})
        assert (answer.status_code == 200) == allowed
        answer = web.client.get("/jobs", headers={"Origin": origin, **bearer("ann")})
        assert answer.headers.get("access-control-allow-origin") == (origin if allowed else None)
        refused = web.client.get("/jobs", headers={"Origin": origin})
        assert refused.status_code == 401
        assert ("access-control-allow-origin" in refused.headers) == allowed


@pytest.mark.parametrize("path", ["/bitstreams/{}.sg", *(f"/decode/{{}}.{kind}?width=20" for kind in MEDIA_TYPES)])
def test_what_a_client_has_already(web: Service, done: str, path: str) -> None:
    """RFC 9110, 13.1.2: tags compare weakly. A HEAD says what a GET does."""
    url = path.format(done)
    whole = web.client.get(url)
    etag = whole.headers["etag"]
    kind = path.partition("?")[0].rpartition(".")[2]
    assert whole.headers["content-type"] == MEDIA_TYPES.get(kind, "application/octet-stream")  # type: ignore[call-overload]
    assert "immutable" in whole.headers["cache-control"]
    for known, status in (
        *((etag, 304), (f"W/{etag}", 304), (f'"other", {etag}', 304), ("*", 304)),
        *(('"other"', 200), (",", 200), (f"W/{etag[:-1]}1", 200)),
    ):
        for method in ("GET", "HEAD"):
            answer = web.client.request(method, url, headers={"If-None-Match": known})
            assert (answer.status_code, answer.headers["etag"]) == (status, etag)
            assert answer.content == (whole.content if (status, method) == (200, "GET") else b"")
            same = ("content-type", "content-length", "cache-control") if status == 200 else ("cache-control",)
            assert [answer.headers[name] for name in same] == [whole.headers[name] for name in same]


def test_lines_of_one_header_are_one_list(web: Service, done: str) -> None:
    """RFC 9110, 5.3: several lines are one with commas, and where one value alone is allowed they are none."""
    url = f"/bitstreams/{done}.sg"
    etag = web.client.head(url).headers["etag"]
    assert web.client.get(url, headers=[("If-None-Match", '"other"'), ("If-None-Match", etag)]).status_code == 304
    picture = web.client.get(f"/decode/{done}", headers=[("Accept", "text/html"), ("Accept", "image/webp")])
    assert picture.headers["content-type"] == "image/webp"
    assert web.client.get(f"/decode/{done}", headers=[("Accept", "")]).status_code == 200
    keys = [("Content-Type", "image/png"), ("Idempotency-Key", "one"), ("Idempotency-Key", "two")]
    assert_problem(web.client.post("/encode", content=SMALL, headers=keys), 400, "Idempotency-Key")
    types = [("Content-Type", "image/png"), ("Content-Type", "multipart/form-data; boundary=B")]
    assert_problem(web.client.post("/encode", content=SMALL, headers=types), 415, "one Content-Type")
