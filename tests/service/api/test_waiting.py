"""One request is enough: POST /encode that waits for its file, and an image that is encoded again unsent."""

from __future__ import annotations

import contextlib
import io
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import httpx
import pytest
from PIL import Image

import sgmethod
from service.api.requests import MAX_WAIT_S
from service.settings import Settings
from tests.support.data import PICTURE
from tests.support.job_table import change
from tests.support.pictures import SMALL
from tests.support.processes import wait_until
from tests.support.service import Service, StartService, assert_problem, bearer, keys_of

BODY = {"Content-Type": "image/png"}
QUICK = "time_limit_s=0.1"


def test_a_photograph_becomes_a_file(service: Service) -> None:
    """As `curl -F image=@photo.jpg 'http://HOST/encode?wait=50' -o photo.sg` does it: no budget, no second request."""
    answer = service.client.post("/encode?wait=100", files={"image": ("photo.png", SMALL)}, data={"time_limit_s": "1"})
    assert (answer.status_code, answer.headers["content-type"]) == (200, "application/octet-stream")
    assert (sgmethod.info(answer.content).width, sgmethod.info(answer.content).height) == (64, 48)
    assert 8 * len(answer.content) <= 0.3 * 64 * 48  # the budget unasked
    job = service.client.get(answer.headers["location"]).json()
    assert job["budget"] == {"kind": "bpp", "value": 0.3}
    assert service.client.get(job["bitstream_url"]).content == answer.content


PICTURE_ANSWER = {"content-type": "image/webp", "vary": "Accept", "cache-control": "no-store"}


@pytest.mark.parametrize(
    ("query", "headers", "answered"),
    [
        ("&wait=100", {"Accept": "image/webp", "If-None-Match": "*"}, PICTURE_ANSWER),
        ("&wait=100", {"Accept": "image/webp;q=0.9, image/png;q=0.2"}, PICTURE_ANSWER),
        ("&wait=100", {"Accept": "text/html, image/webp"}, PICTURE_ANSWER),
        ("&wait=300", {}, {"content-type": "application/octet-stream"}),
    ],
)
def test_ways_to_wait(quick: Service, query: str, headers: dict[str, str], answered: dict[str, str]) -> None:
    """A long one is cut before a proxy gives up, as the usual one does after 60 s."""
    answer = quick.client.post(f"/encode?{QUICK}{query}", content=SMALL, headers={**BODY, **headers})
    assert answer.status_code == 200
    assert {name: answer.headers[name] for name in answered} == answered
    if answered is PICTURE_ANSWER:
        assert Image.open(io.BytesIO(answer.content)).size == (64, 48)
    assert MAX_WAIT_S < 60


def test_what_is_not_done_in_time_is_a_job(web: Service) -> None:
    """Here it never is."""
    answer = web.client.post("/encode?wait=1", content=SMALL, headers=BODY)
    assert answer.status_code == 202
    assert web.job(answer.json()["id"])["state"] == "queued"


@pytest.mark.parametrize("query", ["wait=x", "wait=-1", "wait=1.5", "wait=", "wiat=1"])
def test_waits_that_are_refused(web: Service, query: str) -> None:
    assert_problem(web.client.post(f"/encode?{query}", content=SMALL, headers=BODY), 422)


def test_a_job_that_fails_or_is_removed_meanwhile(empty: Service) -> None:
    def ask() -> httpx.Response:
        return httpx.post(f"{empty.url}/encode?wait=100", content=SMALL, headers=BODY, timeout=200)

    def only_job() -> str:
        jobs = wait_until(lambda: empty.client.get("/jobs?limit=1").json()["jobs"])
        return str(jobs[0]["id"])

    with ThreadPoolExecutor(1) as pool:
        asking = pool.submit(ask)
        job_id = only_job()
        empty.refuse(job_id)
        problem = assert_problem(asking.result(), 422, "it is refused")
        assert (problem["id"], problem["code"]) == (job_id, "refused")
        empty.client.delete(f"/jobs/{job_id}")
        asking = pool.submit(ask)
        empty.client.delete(f"/jobs/{only_job()}")
        assert_problem(asking.result(), 409, "removed")


@pytest.mark.thorough
def test_places_to_wait_or_watch(start_service: StartService) -> None:
    """Who goes leaves a job, and no place taken. Who finds none gets a job at once. One client has half."""
    web = start_service("web")

    def wait_for(taken: int) -> None:
        wait_until(lambda: web.figures()["sgmethod_streams"] == taken)

    with web.connect() as lost:
        head = f"Host: localhost\r\nContent-Type: image/png\r\nContent-Length: {len(SMALL)}\r\n\r\n"
        lost.sendall(b"POST /encode?wait=300 HTTP/1.1\r\n" + head.encode() + SMALL)
        wait_for(taken=1)
    wait_for(taken=0)
    (job,) = web.client.get("/jobs").json()["jobs"]
    with contextlib.ExitStack() as crowd:
        for _ in range(Settings.max_streams // 2):
            stream = crowd.enter_context(web.connect())
            stream.sendall(f"GET /jobs/{job['id']}/events HTTP/1.1\r\nHost: localhost\r\n\r\n".encode())
        wait_for(taken=Settings.max_streams // 2)
        answer = web.client.post("/encode?wait=300", content=SMALL, headers=BODY)
        assert answer.status_code == 202
        assert_problem(web.client.get(f"/jobs/{job['id']}/events"), 503, "streams")
    wait_for(taken=0)


@pytest.mark.thorough
def test_a_job_table_that_goes_away_meanwhile(start_service: StartService) -> None:
    """The image was accepted: a client that gets Retry-After would submit it again."""
    web = start_service("web")

    def ask() -> httpx.Response:
        return httpx.post(f"{web.url}/encode?wait=20", content=SMALL, headers=BODY, timeout=100)

    with ThreadPoolExecutor(1) as pool:
        asking = pool.submit(ask)
        wait_until(lambda: web.client.get("/jobs").json()["jobs"])
        (web.data_dir / "jobs.sqlite3").rename(web.data_dir / "aside")
        answer = asking.result()
    assert (answer.status_code, answer.headers["location"]) == (202, answer.json()["status_url"])


@pytest.mark.thorough
def test_whose_image_is_encoded_again_and_how(start_service: StartService) -> None:
    web = start_service("web", source_retention_s=1000, api_keys=keys_of("ann", "bob"), queue_length=8)
    web.client.headers.update(bearer("ann"))
    done, waiting = web.accepted(), web.accepted()
    web.publish(done, PICTURE)

    def again(job_id: str, query: str = "bpp=0.5", **headers: str) -> httpx.Response:
        return web.client.post(f"/jobs/{job_id}/encode?{query}", headers=headers)

    answer = again(done, "psnr=30&profile=paper&priority=bulk", **{"Idempotency-Key": "one"})
    assert answer.status_code == 202, answer.text
    job = web.job(answer.json()["id"])
    assert (job["budget"], job["profile"]) == ({"kind": "psnr", "value": 30}, "paper")
    assert (job["priority"], job["image"]) == ("bulk", web.job(done)["image"])
    assert (web.data_dir / "sources" / job["id"]).read_bytes() == SMALL
    assert again(done, "psnr=30&profile=paper&priority=bulk", **{"Idempotency-Key": "one"}).json() == answer.json()
    assert_problem(again(done, **{"Idempotency-Key": "one"}), 422, "Idempotency-Key")
    for query, words in (("bpp=x", "number"), ("wiat=1", "unknown field"), ("bytes=1", "least"), ("psnr=1&psnr=1", "")):
        assert_problem(again(done, query), 422, words)
    assert_problem(again(done, Authorization="Bearer bob"), 404)
    assert_problem(again(done, Authorization="Bearer"), 401)
    assert_problem(again("0" * 32), 404)
    assert again(waiting).status_code == 202  # as long as a job is not finished its image is there anyway
    assert again(waiting).status_code == 202
    assert_problem(again(waiting), 429, "4 jobs")


def test_a_repeated_request_gets_its_job_after_the_first_is_deleted(keeping: Service) -> None:
    source = keeping.accepted()
    path = f"/jobs/{source}/encode?bpp=0.5"
    first = keeping.client.post(path, headers={"Idempotency-Key": "again"})
    assert first.status_code == 202, first.text
    assert keeping.client.delete(f"/jobs/{source}").status_code == 204
    repeated = keeping.client.post(path, headers={"Idempotency-Key": "again"})
    assert (repeated.status_code, repeated.json()) == (202, first.json())
    assert_problem(keeping.client.post(f"/jobs/{source}/encode", headers={"Idempotency-Key": "again"}), 422)
    for headers in ({}, {"Idempotency-Key": "new"}):
        assert_problem(keeping.client.post(path, headers=headers), 404)


@pytest.mark.thorough
def test_fields_in_a_body_count(keeping: Service) -> None:
    """They were ignored, and the image encoded at 0.3 bpp."""
    done = keeping.accepted()
    keeping.publish(done, PICTURE)

    def again(query: str = "", **body: Any) -> httpx.Response:
        return keeping.client.post(f"/jobs/{done}/encode{query}", **body)

    def form(*fields: tuple[str, str]) -> dict[str, Any]:
        return {"files": [(name, (None, text)) for name, text in fields]}

    answer = again("?effort=3", **form(("bytes", "300"), ("priority", "bulk")))
    assert answer.status_code == 202, answer.text
    job = keeping.job(answer.json()["id"])
    assert (job["budget"], job["priority"], job["effort"]) == ({"kind": "bytes", "value": 300}, "bulk", 3)
    assert_problem(again("?bytes=300", **form(("bytes", "300"))), 422, "twice")
    assert_problem(again(**form(("wiat", "1"))), 422, "unknown field")
    assert_problem(again(**form(("image", "x"))), 422, "image")
    assert_problem(again("?image=x"), 422, "image")
    assert_problem(again(files={"image": ("a.png", SMALL)}), 400, "files")
    for body in ({"data": {"bytes": "300"}}, {"json": {"bytes": 300}}, {"content": SMALL, "headers": BODY}):
        assert_problem(again(**body), 415, "multipart/form-data")
    for nothing in ({}, {"content": b"", "headers": BODY}, {"content": iter([b""])}):
        assert again("?bpp=1", **nothing).status_code == 202


@pytest.mark.parametrize("path", ["/jobs/{}/links", "/jobs/{}/stop", "/jobs/{}"])
def test_no_other_body_is_ignored(empty: Service, path: str) -> None:
    job_id = empty.accepted()
    method = "DELETE" if path == "/jobs/{}" else "POST"
    answer = empty.client.request(method, path.format(job_id), data={"expires_s": "60"})
    assert_problem(answer, 422, "no body")
    assert empty.job(job_id)["state"] == "queued"


def test_an_image_comes_once(web: Service) -> None:
    image = ("any.png", SMALL)
    for files in ([("image", (None, "x"))], [("image", image), ("image", (None, "x"))], []):
        fields = [*files, ("bpp", (None, "1"))]
        assert_problem(web.client.post("/encode", files=fields), 422, "image is missing")
    assert_problem(web.client.post("/encode", files=[("image", image), ("image", image)]), 400)
    assert_problem(web.client.post("/encode?image=x", files=[("image", image)]), 422, "unknown field 'image'")


@pytest.mark.thorough
def test_images_that_are_no_longer_kept(keeping: Service) -> None:
    swept, late = keeping.accepted(), keeping.accepted()
    for job_id in (swept, late):
        keeping.publish(job_id, PICTURE)
        assert keeping.client.post(f"/jobs/{job_id}/encode").status_code == 202
    (keeping.data_dir / "sources" / swept).unlink()
    with keeping.table() as table:
        change(table, "UPDATE jobs SET finished_at = finished_at - 1000 WHERE id = ?", late)
    before = keeping.files()
    assert f"sources/{late}" in before  # which the next sweep removes
    for job_id in (swept, late):
        assert_problem(keeping.client.post(f"/jobs/{job_id}/encode"), 410, "send it again")
    assert keeping.files() == before
    assert keeping.client.delete(f"/jobs/{late}").status_code == 204
    assert not any(late in name for name in keeping.files())
