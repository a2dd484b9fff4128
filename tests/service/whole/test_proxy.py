"""Behind nginx, set up as docs/deploy.md says: under / and under a path, with large bodies, long waits and events."""

from __future__ import annotations

import io
import os
import re
import shutil
import socket
import subprocess
import time
from collections.abc import Callable, Iterator
from urllib.parse import urlsplit

import httpx
import numpy as np
import pytest
from PIL import Image

import sgmethod
from sgmethod.client import client
from tests.harness.browser import Chromium
from tests.harness.data import ROOT
from tests.harness.pictures import SLOW, SMALL
from tests.harness.processes import PATIENCE_S, wait_until
from tests.harness.service import STAND_IN, Service
from tests.service.page.steps import complaints, give

NGINX = shutil.which("nginx") or shutil.which("nginx", path="/usr/sbin")
REQUIRED = "SGMETHOD_TEST_NGINX"  # set to "required", a missing nginx fails the tests
HINT = "nginx is not installed, so nothing was tested behind it: sudo apt install nginx"
(BLOCK,) = re.findall(r"```nginx\n(.*?)```", (ROOT / "docs" / "deploy.md").read_text(), re.DOTALL)
AROUND = """
daemon off; {user} pid {folder}/pid; error_log {folder}/error.log; events {{}}
http {{
    access_log off; include /etc/nginx/mime.types;
    client_body_temp_path {folder}/body; proxy_temp_path {folder}/proxy; fastcgi_temp_path {folder}/fastcgi;
    uwsgi_temp_path {folder}/uwsgi; scgi_temp_path {folder}/scgi;
    {block}
}}
"""
PREFIX = "/sg"
StartProxy = Callable[[Service, str, bool], str]


def replaced(text: str, old: str, new: str) -> str:
    assert old in text
    return text.replace(old, new)


@pytest.fixture(scope="module")
def start_proxy(tmp_path_factory: pytest.TempPathFactory) -> Iterator[StartProxy]:
    """Starts nginx before a service, under a prefix that it may cut off; where it is then."""
    if NGINX is None:
        if os.environ.get(REQUIRED) == "required":
            pytest.fail(HINT)
        pytest.skip(HINT)
    started: list[subprocess.Popen[bytes]] = []

    def start(service: Service, prefix: str, cut: bool) -> str:
        with socket.create_server(("127.0.0.1", 0)) as free:
            port = free.getsockname()[1]
        block = replaced(BLOCK, "listen 80;", f"listen 127.0.0.1:{port};")
        block = replaced(block, "http://127.0.0.1:8000;", f"{service.url}{'/' if cut else ''};")
        block = replaced(block, "location / {", f"location {prefix}/ {{")
        user = "user root;" if os.geteuid() == 0 else ""  # no other may enter the folder
        folder = tmp_path_factory.mktemp("nginx")
        (folder / "nginx.conf").write_text(AROUND.format(folder=folder, block=block, user=user))
        command = [str(NGINX), "-c", str(folder / "nginx.conf"), "-e", str(folder / "error.log")]
        started.append(subprocess.Popen(command))
        root = f"http://127.0.0.1:{port}{prefix}"
        wait_until(lambda: answers(root))
        return root

    yield start
    for process in started:
        process.terminate()
        process.wait(PATIENCE_S)


def answers(root: str) -> bool:
    try:
        return httpx.get(f"{root}/livez").is_success
    except httpx.TransportError:
        return False


@pytest.fixture(
    scope="module", params=[("", False), (PREFIX, False), (PREFIX, True)], ids=["root", "prefix", "prefix-cut"]
)
def proxied(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory, start_proxy: StartProxy
) -> Iterator[tuple[Service, str]]:
    """A service with a stand-in for the codec, whose images are kept, and where it is to be found."""
    prefix, cut = request.param
    settings = {"trusted_proxies": "127.0.0.1", "path_prefix": prefix, "link_secret": "x" * 32}
    data_dir = tmp_path_factory.mktemp("proxied") / "data"
    service = Service(data_dir, source_retention_s=1000, extra=STAND_IN, **settings)
    yield service, start_proxy(service, prefix, cut)
    assert service.stop() == 0


@pytest.fixture
def behind(proxied: tuple[Service, str]) -> Iterator[str]:
    """Where the service is to be found, which has no jobs."""
    service, root = proxied
    yield root
    service.clear()


def test_addresses_in_answers_lead_back(behind: str) -> None:
    """Location, the URLs of a job, of a page of jobs and of links: all were without the prefix."""
    prefix = urlsplit(behind).path
    host = behind.removesuffix(prefix)
    fields = {"time_limit_s": "0.1"}
    first = httpx.post(f"{behind}/encode?wait=50", files={"image": SMALL}, data=fields, timeout=PATIENCE_S)
    assert first.status_code == 200, first.text
    assert first.headers["location"].startswith(f"{prefix}/jobs/")
    again = httpx.post(f"{host}{first.headers['location']}/encode?wait=50&time_limit_s=0.1", timeout=PATIENCE_S)
    assert again.status_code == 200
    accepted = httpx.post(f"{behind}/encode", files={"image": SMALL}, data=fields).json()
    assert httpx.get(host + accepted["status_url"]).status_code == 200
    job = httpx.get(host + first.headers["location"]).json()
    for name, kind in (("decode_url", "image/png"), ("bitstream_url", "application/octet-stream")):
        assert httpx.get(host + job[name]).headers["content-type"] == kind
        link = httpx.post(f"{host}{job['status_url']}/links").json()[name]
        assert httpx.get(host + link).headers["content-type"] == kind
    page = httpx.get(f"{behind}/jobs?limit=2").json()
    assert len(httpx.get(host + page["next"]).json()["jobs"]) == 1
    servers = httpx.get(f"{behind}/openapi.json").json().get("servers", [{"url": ""}])
    assert servers == [{"url": prefix}]
    assert httpx.get(f"{host}/nothing").status_code == 404


def test_a_client_sees_every_page_of_jobs(behind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The address of the next page had the prefix twice."""
    monkeypatch.setattr(client, "PAGE", 1)
    fields = {"time_limit_s": "0.1"}
    made = {httpx.post(f"{behind}/encode", files={"image": SMALL}, data=fields).json()["id"] for _ in range(3)}
    with client.Client(behind) as ours:
        assert {job["id"] for job in ours.jobs()} == made


def test_large_bodies_pass(behind: str) -> None:
    """nginx by itself refuses more than 1 MB."""
    noise = np.random.default_rng(1).integers(0, 256, (1000, 1000, 3), np.uint8)
    file = io.BytesIO()
    Image.fromarray(noise).save(file, "PNG")
    assert len(file.getvalue()) > 2_000_000
    files, fields = {"image": file.getvalue()}, {"time_limit_s": "0.1"}
    answer = httpx.post(f"{behind}/encode?wait=50", files=files, data=fields, timeout=PATIENCE_S)
    assert answer.status_code == 200, answer.text
    assert sgmethod.info(answer.content).width == 1000


def test_events_are_not_held_back(behind: str) -> None:
    """The job is far from done when the first of them come."""
    fields = {"time_limit_s": "100"}
    job = httpx.post(f"{behind}/encode", files={"image": SLOW}, data=fields).json()["id"]
    with httpx.stream("GET", f"{behind}/jobs/{job}/events", timeout=PATIENCE_S) as answer:
        began, lines = time.monotonic(), answer.iter_lines()
        assert next(lines).startswith("event: state")
        wait_until(lambda: next(lines).startswith("event: trace"))
        assert time.monotonic() - began < 90
    assert httpx.delete(f"{behind}/jobs/{job}").status_code == 204


def test_the_page_works(behind: str, browser: Chromium) -> None:
    """Its scripts, a sample, an encode, and the page of requests."""
    browser.complaints()
    browser.open(f"{behind}/")
    wait_until(lambda: browser.is_seen("#right-label") and browser.is_seen("#left-label"))
    browser.run("document.getElementById('more').open = true; document.getElementById('time-limit').value = '0.1'")
    give(browser, "drop", SMALL, "one.png")
    wait_until(lambda: len(browser.run("return location.hash")) == len("#") + 32)
    command = "return document.getElementById('curl').textContent"
    wait_until(lambda: browser.run(command).endswith("one.sg"))
    assert f"'{behind}/encode?wait=50'" in browser.run(command)
    assert complaints(browser) == []
    browser.open(f"{behind}/docs")
    wait_until(lambda: browser.run("return document.querySelectorAll('#operations details').length"))
    assert browser.run(f"return document.body.textContent.includes('{behind}/encode?wait=50')")
    browser.open("about:blank")
