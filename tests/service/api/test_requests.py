"""What may be asked of the web process, and what it answers when it may not. Nothing is encoded here."""

from __future__ import annotations

import contextlib
import dataclasses
import inspect
import re
import socket
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import httpx2
import pytest
from PIL import Image

import sgmethod
from service.api.encode import OPTION_SCHEMAS, queries
from service.api.jobs import JobSummary
from service.api.problems import NAMED_REASONS, REASONS
from sgmethod.budget import DEFAULT_BUDGET, bytes_value
from sgmethod.client.client import Options
from sgmethod.encode_arguments import EncodeOptions
from tests.support.data import JAVASCRIPT, PICTURE, ROOT, STATIC
from tests.support.pictures import SMALL, png, saved
from tests.support.processes import wait_until
from tests.support.profiles import OTHER
from tests.support.service import SMALL_QUEUE, Service, StartService, assert_problem

GOOD_ID = "0123456789abcdef" * 2


def test_every_answer_has_the_security_headers(web: Service) -> None:
    for path in ("/", "/docs", "/livez", "/nowhere", f"/jobs/{GOOD_ID}", "/static/main.js"):
        headers = web.client.get(path).headers
        assert headers["x-content-type-options"] == "nosniff"
        assert headers["referrer-policy"] == "no-referrer"
        assert headers["content-security-policy"].startswith("default-src 'none'")


def test_every_kind_of_problem_is_explained(web: Service) -> None:
    """Each at the address that its document names."""
    sources = "".join(path.read_text() for path in (ROOT / "service").rglob("*.py"))
    named = {word for pair in re.findall(r'reason="(\w+)"|LimitError\("(\w+)"', sources) for word in pair if word}
    assert named <= {*REASONS.values(), *NAMED_REASONS}
    kinds = {*REASONS.values(), *NAMED_REASONS}
    kinds |= {*re.findall(r"/docs#(\w+)", (ROOT / "docs" / "nginx.conf").read_text())}
    problem = assert_problem(web.client.get("/nowhere"), 404)
    page = web.client.get(problem["type"])
    assert (page.status_code, page.headers["content-type"]) == (200, "text/html; charset=utf-8")
    assert sorted(re.findall(r'<tr id="(\w+)"', page.text)) == sorted(kinds)


def test_page_names_nothing_elsewhere(web: Service) -> None:
    page = web.client.get("/")
    assert page.headers["content-type"].startswith("text/html")
    assert "script-src 'self'" in page.headers["content-security-policy"]
    files = [f"/static/{file.relative_to(STATIC)}" for kind in ("js", "css") for file in STATIC.rglob(f"*.{kind}")]
    files += [f"/static/sgmethod/{file.name}" for file in JAVASCRIPT.glob("*.js")]
    assert len(files) > 20
    for path in ("/", "/docs", *files):
        answer = web.client.get(path)
        assert answer.status_code == 200
        assert "://" not in answer.text.replace("http://www.w3.org", "").replace("http://127.0.0.1:8000", "")


def test_unknown_paths_and_methods_are_problems(web: Service) -> None:
    assert_problem(web.client.get("/nowhere"), 404)
    for path in ("/static/nothing.js", "/static/sgmethod/nothing.js"):
        assert assert_problem(web.client.get(path), 404)["type"] == "/docs#unknown"
    answer = web.client.put(f"/jobs/{GOOD_ID}")
    assert_problem(answer, 405)
    assert answer.headers["allow"] == "DELETE, GET"
    assert_problem(web.client.get("/encode"), 405)
    assert_problem(web.client.put("/static/main.js"), 405)


def test_a_waiting_job_has_a_place_and_no_picture_yet(empty: Service) -> None:
    first, second = empty.accepted(), empty.accepted()
    assert (empty.job(first)["position"], empty.job(second)["position"]) == (1, 2)
    job = empty.job(second)
    assert (job["state"], job["progress"], job["trace"], job["attempt"]) == ("queued", 0, [], 0)
    for url in ("decode_url", "bitstream_url"):
        assert assert_problem(empty.client.get(job[url]), 409)["state"] == "queued"
    assert empty.client.delete(f"/jobs/{first}").status_code == 204
    assert empty.job(second)["position"] == 1
    assert empty.files() == [f"sources/{second}"]


def test_jobs_are_listed_newest_first_in_pages(empty: Service) -> None:
    """All, or those of a state."""

    def listed(query: str) -> list[str]:
        seen, url = [], f"/jobs?limit=2{query}"
        while url:
            page = empty.client.get(url).json()
            assert len(page["jobs"]) <= 2
            seen += [job["id"] for job in page["jobs"]]
            url = page["next"]
        return seen

    assert listed("") == []
    done = [empty.published(PICTURE) for _ in range(3)]
    waiting = [empty.accepted() for _ in range(2)]
    assert listed("") == [*waiting[::-1], *done[::-1]]
    states = ("done", "queued", "failed")
    assert [listed(f"&state={state}") for state in states] == [done[::-1], waiting[::-1], []]
    for query in ("limit=0", "limit=201", "limit=x", "before=0", "before=" + "9" * 30, "state=lost"):
        assert assert_problem(empty.client.get(f"/jobs?{query}"), 422)["errors"]


# By a word of the answer.
REFUSED_FIELDS: dict[str, list[dict[str, str]]] = {
    "give one": [{"bpp": "1", "psnr": "30"}, {"bpp": "1", "quality": "9"}],
    "positive": [{"bpp": value} for value in ("0", "-1", "1e999", "nan", "inf")] + [{"gaussians": "0"}],
    "valid number": [{"bpp": value} for value in ("x", "", "\u0663")],
    "whole": [{"bytes": "10.5"}],
    "a size is a number of bytes": [{"bytes": "many"}],
    "at most 60": [{"psnr": "99"}],
    "at most 100": [{"quality": "101"}],
    "at least 12 bytes": [{"bytes": "11"}, {"bpp": "0.00001"}],
    "takes at least": [{"bytes": "100", "profile": OTHER}],
    "exceed the image's": [{"gaussians": "10000000"}],
    "cannot aim at a quality": [{"quality": "50", "profile": OTHER}],
    "unknown profile": [{"bpp": "1", "profile": "best"}],
    "unknown tune": [{"bpp": "1", "tune": "best"}],
    "can only be tuned for psnr": [
        {"tune": "visual", **more} for more in ({"psnr": "30"}, {"bpp": "1", "profile": OTHER})
    ],
    "effort": [{"bpp": "1", "effort": value} for value in ("10", "5.5", "all")],
    "only profile rd has an effort": [{"bpp": "1", "profile": OTHER, "effort": "9"}],
    "time_limit_s": [{"bpp": "1", "time_limit_s": value} for value in ("0", "1e9", "soon")],
    "unknown field": [{"bpp": "1", "fineness": "9"}],
    "priority": [{"bpp": "1", "priority": "first"}],
}


@pytest.mark.parametrize(("words", "fields"), [(words, one) for words, many in REFUSED_FIELDS.items() for one in many])
def test_fields_that_are_refused(web: Service, words: str, fields: dict[str, str]) -> None:
    before = web.files()
    assert_problem(web.post(SMALL, **fields), 422, words)
    assert web.files() == before


def test_every_program_has_the_options_of_the_codec() -> None:
    """Those of the one table, from which the command line and the service's requests are built."""
    names = {one.name for one in dataclasses.fields(EncodeOptions)}
    assert names <= set(inspect.signature(sgmethod.encode).parameters)
    assert names <= set(OPTION_SCHEMAS)
    assert names <= set(JobSummary.model_fields)
    assert names | {"priority"} == set(Options.__annotations__) | {"profile"}
    assert names - {"profile"} == set(re.findall(r'data-option="(\w+)"', (STATIC / "index.html").read_text()))


def test_what_has_no_body_has_no_type(web: Service) -> None:
    """Clients that go by the type would parse it."""
    answer = web.client.delete(f"/jobs/{web.accepted()}")
    assert (answer.status_code, answer.content) == (204, b"")
    assert "content-type" not in answer.headers


def test_a_quality_is_a_number_or_a_name(web: Service) -> None:
    number, name = OPTION_SCHEMAS["quality"]["anyOf"]
    assert (number["maximum"], name["enum"]) == (100, ["preview", "web", "archive"])
    assert web.job(web.accepted(quality="web"))["budget"] == web.job(web.accepted(quality="60"))["budget"]


def test_every_documented_form_of_a_size_is_described_and_accepted() -> None:
    """The document's pattern forbade 20KiB, so clients made from it refused what the service takes."""
    text = "".join((ROOT / name).read_text() for name in ("docs/command_line.md", "service/README.md"))
    lines = "".join(line for line in text.splitlines() if "`20k`" in line)
    sizes = set(re.findall(r"`([\d.]+[kKM]?i?B?)`", lines))
    assert sizes == {"20000", "20k", "1.5MB", "20KiB", "1.5MiB"}
    texts = next(form["pattern"] for form in OPTION_SCHEMAS["bytes"]["anyOf"] if form["type"] == "string")
    for size in sizes | {"20kB"}:
        assert size.isdigit() or re.fullmatch(texts, size), size
        assert queries.validate_python({"bytes": size}).bytes == bytes_value(size)
    assert not re.fullmatch(texts, "20ki")  # which is refused


def test_a_tiny_image_without_a_budget_is_accepted(web: Service) -> None:
    """0.5 bits per pixel of it are fewer bytes than the smallest file has; asked for, they are refused."""
    tiny = png(8, 8)
    assert web.job(web.accepted(tiny, effort=1))["budget"]["kind"] == "bytes"
    assert_problem(web.post(tiny, bpp=str(DEFAULT_BUDGET.max_bpp)), 422, "at least 12 bytes")


def test_forms_that_are_refused(web: Service) -> None:
    post = web.client.post
    image, text, option = ("image", ("a.png", SMALL)), ("image", (None, "text")), ("bpp", (None, "1"))
    file = ("bpp", ("b.txt", b"1"))
    assert_problem(post("/encode?bpp=1", json={"bpp": 1}), 415, "PNG, JPEG")
    assert_problem(post("/encode", data={"bpp": "1"}), 415)
    assert_problem(post("/encode", content=b"x", headers={"Content-Type": "multipart/form-data"}), 400)
    other = {"Content-Type": "multipart/form-data; boundary=b"}
    assert_problem(post("/encode", content=b"--c\r\n", headers=other), 400)
    for fields in ([option], [text, option], [image, text], [file]):
        assert_problem(post("/encode", files=fields), 422, "image is missing, is not a file, or is given twice")
    for fields in ([image, image], [image, file]):
        assert_problem(post("/encode", files=fields), 400)
    assert_problem(post("/encode", files=[image, option, option]), 422, "twice")
    assert_problem(post("/encode?image=x", files=[image]), 422, "unknown field 'image'")
    assert_problem(post("/encode", files=[image, ("bpp", (None, "1" * 2000))]), 400, "maximum size of 1KB")
    key = {"Idempotency-Key": "with space"}
    assert_problem(post("/encode", files=[image], headers=key), 400, "Idempotency-Key")


def test_an_image_as_the_body(web: Service) -> None:
    def post(query: str, **more: Any) -> httpx2.Response:
        options = {"content": SMALL, "headers": {"Content-Type": "image/png"}, **more}
        return web.client.post(f"/encode{query}", **options)

    answer = post(f"?psnr=30&profile={OTHER}&time_limit_s=2&priority=bulk")
    assert answer.status_code == 202, answer.text
    job = web.job(answer.json()["id"])
    assert (job["budget"], job["profile"]) == ({"kind": "psnr", "value": 30, "max_bpp": None}, OTHER)
    assert (job["time_limit_s"], job["priority"], job["tune"], job["effort"]) == (2, "bulk", "psnr", 5)
    unasked = web.job(post("?bpp=1").json()["id"])
    assert (unasked["tune"], unasked["effort"]) == ("visual", 5)
    assert (unasked["priority"], unasked["time_limit_s"]) == ("interactive", 300)  # the longest
    assert web.job(post("?bpp=1&effort=7").json()["id"])["effort"] == 7
    assert web.job(post("?quality=40").json()["id"])["budget"] == {"kind": "quality", "value": 40, "max_bpp": None}
    assert web.job(post("?bytes=1.5k").json()["id"])["budget"] == {"kind": "bytes", "value": 1500, "max_bpp": None}
    assert web.job(post("").json()["id"])["budget"] == dataclasses.asdict(DEFAULT_BUDGET)
    assert web.job(post("?bpp=1&tune=psnr").json()["id"])["tune"] == "psnr"
    assert web.job(post("?bpp=1&tune=fidelity").json()["id"])["tune"] == "fidelity"
    assert (web.data_dir / "sources" / job["id"]).read_bytes() == SMALL
    form = post("?bpp=1", content=None, headers={}, files={"image": ("a.png", SMALL)})
    assert web.job(form.json()["id"])["budget"] == {"kind": "bpp", "value": 1, "max_bpp": None}

    for kind in ({}, {"Content-Type": "text/plain"}):  # of which the client may know nothing
        assert post("?bpp=1", headers=kind).status_code == 202
        assert web.client.post("/preview", content=SMALL, headers=kind).status_code == 200

    before = web.files()
    assert_problem(post("?bpp=1&bpp=1"), 422, "twice")
    assert_problem(post("?bpp=1", content=iter([bytes(100_000)] * 3)), 413)
    form = post("?bpp=1", content=None, headers={}, files={"image": ("a.png", SMALL)}, data={"bpp": "1"})
    assert_problem(form, 422, "twice")
    assert web.files() == before


def test_the_users_file_name_goes_nowhere(web: Service) -> None:
    files = {"image": ("../../../escape.png", SMALL)}
    answer = web.client.post("/encode", files=files, data={"bpp": "1"})
    assert answer.status_code == 202
    assert f"sources/{answer.json()['id']}" in web.files()
    assert "escape" not in web.client.get(answer.json()["status_url"]).text


def test_image_larger_than_the_limit(web: Service) -> None:
    image = {"Content-Type": "image/png"}
    fits, large = (web.client.post("/encode", content=SMALL.ljust(n, b"\0"), headers=image) for n in (200_000, 200_001))
    assert fits.status_code == 202
    assert assert_problem(large, 413)["max_bytes"] == 200_000
    assert_problem(web.post(SMALL.ljust(200_000, b"\0")), 413)


def test_uploads_on_their_way_lie_in_the_data_folder(start_service: StartService) -> None:
    """A container's /tmp is small."""
    web = start_service("web")
    size, kind = 2 << 20, "Content-Type: image/png"
    with socket.create_connection((web.client.base_url.host, web.client.base_url.port)) as connection:
        head = f"POST /encode HTTP/1.1\r\nHost: localhost\r\n{kind}\r\nContent-Length: {size}\r\n\r\n"
        connection.sendall(head.encode() + bytes(size - 1))

        def folders() -> set[Path]:
            found = set()
            for file in Path(f"/proc/{web.process.pid}/fd").iterdir():
                with contextlib.suppress(FileNotFoundError):  # it has been closed meanwhile
                    found.add(file.readlink().parent)
            return found

        wait_until(lambda: web.data_dir / "unfinished" in folders())
        assert Path(tempfile.gettempdir()) not in folders()


def test_a_webp_within_the_limit_is_taken(keeping: Service) -> None:
    """Of which libwebp reserves memory for all pixels before it tells how many there are."""
    file = bytearray(saved(Image.new("RGB", (64, 64)), "WEBP"))
    size = file.index(b"\x9d\x01\x2a") + 3  # width and height of a VP8 frame, 16 bits each
    for width, height, status in ((8000, 6000, 202), (7143, 7000, 422)):
        file[size : size + 4] = width.to_bytes(2, "little") + height.to_bytes(2, "little")
        answer = keeping.post(bytes(file))
        assert answer.status_code == status, answer.text
    assert_problem(answer, 422, "too large: 7143 x 7000 pixels")


def test_one_key_makes_one_job(web: Service) -> None:
    first = web.post(SMALL, key="once", bpp=1)
    again = web.post(SMALL, key="once", bpp=1)
    assert (first.status_code, again.status_code) == (202, 202)
    assert again.json() == first.json()
    assert again.headers["location"] == first.headers["location"]
    files = web.files()
    assert_problem(web.post(SMALL, key="once", bpp=2), 422, "Idempotency-Key")
    assert_problem(web.post(png(64, 48, seed=1), key="once", bpp=1), 422, "Idempotency-Key")
    assert web.files() == files


def test_a_key_is_known_whatever_has_changed_since(start_service: StartService) -> None:
    """Settings, and the space on the disk."""
    web = start_service("web")
    first = web.post(key="first")
    assert first.status_code == 202
    web.stop()
    web.environment |= {"SG_MAX_TIME_LIMIT_S": "0.05", "SG_QUOTA_BYTES": "1", "SG_MAX_UPLOAD_BYTES": str(2**50)}
    web.environment |= {"SG_MAX_PIXELS": "1", "SG_QUEUE_LENGTH": "1"}
    web.start()
    assert web.post(key="first").json() == first.json()
    assert_problem(web.post(png(64, 48, seed=1), key="first", bpp=1), 422, "Idempotency-Key")
    assert web.post(key="third").status_code == 429


def test_full_queue(empty: Service) -> None:
    first = empty.post(key="first")
    for _ in range(SMALL_QUEUE - 1):
        empty.accepted()
    answer = empty.post()
    assert_problem(answer, 429, f"{SMALL_QUEUE} jobs")
    assert int(answer.headers["retry-after"]) > 0
    assert len(empty.files()) == SMALL_QUEUE
    with httpx2.Client(transport=httpx2.HTTPTransport(local_address="127.0.0.2")) as other:
        assert other.post(f"{empty.url}/encode?bpp=1", content=SMALL).status_code == 202
    assert empty.post(key="first").json() == first.json()
    assert_problem(empty.post(key="new"), 429)
    assert empty.client.delete(first.json()["status_url"]).status_code == 204
    assert empty.post(key="new").status_code == 202


def test_full_queue_holds_when_many_post_at_once(empty: Service) -> None:
    with ThreadPoolExecutor(10) as clients:
        statuses = sorted(clients.map(lambda _: empty.post().status_code, range(10)))
    assert statuses == [202] * SMALL_QUEUE + [429] * (10 - SMALL_QUEUE)
    assert len(empty.files()) == SMALL_QUEUE
