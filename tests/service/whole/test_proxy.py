"""Behind nginx with TLS, set up by docs/nginx.conf: two web processes, under / and under a path, with large bodies and
long waits; and with a database and a store that restart.
"""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from urllib.parse import urlsplit

import httpx2
import pytest

import sgmethod
from sgmethod.client import client, encode_many
from sgmethod.many.manifest import Row
from tests.service.s3_server import S3Server
from tests.support.browser import Chromium
from tests.support.data import PICTURE
from tests.support.nginx import Nginx
from tests.support.pictures import SMALL, noisy_png
from tests.support.postgres_server import PostgresServer
from tests.support.processes import TIMEOUT_S, wait_until
from tests.support.service import FAKE_CODEC, Service, StartService, assert_problem

pytestmark = pytest.mark.thorough

PREFIX = "/sg"
PICTURES = 20
StartProxy = Callable[..., Nginx]


@pytest.fixture(scope="module", params=["", PREFIX], ids=["root", "prefix"])
def proxied(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory, start_proxy: StartProxy
) -> Iterator[tuple[Service, str]]:
    """A service with a fake codec, whose images are kept, and where it is to be found."""
    prefix = request.param
    settings = {"trusted_proxies": "127.0.0.1", "root_path": prefix, "link_secret": "x" * 32}
    data_dir = tmp_path_factory.mktemp("proxied") / "data"
    service = Service(data_dir, source_retention_s=1000, extra=FAKE_CODEC, **settings)
    second = Service(data_dir, "web", source_retention_s=1000, **settings)
    yield service, start_proxy((service.url, second.url), prefix).url
    assert service.stop() == second.stop() == 0


@pytest.fixture
def behind(proxied: tuple[Service, str]) -> Iterator[str]:
    """Where the service is to be found, which has no jobs."""
    service, root = proxied
    yield root
    service.clear()


def posted(root: str, query: str = "", image: bytes = SMALL) -> httpx2.Response:
    """The answer to an encode that does not take long."""
    files, fields = {"image": image}, {"time_limit_s": "0.1"}
    answer = httpx2.post(f"{root}/encode{query}", files=files, data=fields, timeout=TIMEOUT_S)
    assert answer.is_success, answer.text
    return answer


def test_addresses_in_answers_lead_back(behind: str) -> None:
    """Location, the URLs of a job, of a page of jobs and of links: all were without the prefix."""
    prefix = urlsplit(behind).path
    host = behind.removesuffix(prefix)
    first = posted(behind, "?wait=50")
    assert first.status_code == 200
    assert first.headers["location"].startswith(f"{prefix}/jobs/")
    accepted = posted(behind).json()
    assert httpx2.get(host + accepted["status_url"]).status_code == 200
    job = httpx2.get(host + first.headers["location"]).json()
    for name, kind in (("decode_url", "image/png"), ("bitstream_url", "application/octet-stream")):
        assert httpx2.get(host + job[name]).headers["content-type"] == kind
        link = httpx2.post(f"{host}{job['status_url']}/links").json()[name]
        assert httpx2.get(host + link).headers["content-type"] == kind
    page = httpx2.get(f"{behind}/jobs?limit=1").json()
    assert len(httpx2.get(host + page["next"]).json()["jobs"]) == 1
    servers = httpx2.get(f"{behind}/openapi.json").json().get("servers", [{"url": ""}])
    assert servers == [{"url": prefix}]
    assert httpx2.get(f"{host}/nothing").status_code == 404


def test_a_client_sees_every_page_of_jobs(behind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The address of the next page had the prefix twice."""
    monkeypatch.setattr(client, "PAGE", 1)
    made = {posted(behind).json()["id"] for _ in range(3)}
    with client.Client(behind) as ours:
        assert {job["id"] for job in ours.jobs()} == made


def test_large_bodies_pass(behind: str) -> None:
    """nginx by itself refuses more than 1 MB."""
    large = noisy_png(1000)
    assert len(large) > 2_000_000
    assert sgmethod.info(posted(behind, "?wait=50", large).content).width == 1000


def test_clients_keep_their_addresses(proxied: tuple[Service, str]) -> None:
    """Whatever they say of themselves; and both web processes get requests."""
    service, root = proxied
    transport = httpx2.HTTPTransport(local_address="127.0.0.3")
    with httpx2.Client(transport=transport, headers={"X-Forwarded-For": "9.9.9.9"}) as client:
        names = [client.get(f"{root}/jobs").headers["x-request-id"] for _ in range(4)]

    def lines() -> list[str]:
        return [line for line in service.log.read_text().splitlines() if any(name in line for name in names)]

    wait_until(lambda: len(lines()) == len(names))
    assert all("127.0.0.3" in line for line in lines())
    assert "9.9.9.9" not in "".join(lines())


def test_what_nginx_says_itself(start_proxy: StartProxy, start_service: StartService) -> None:
    """Problems that say when to ask again, as the service's; and a log from which nobody can take a link."""
    web = start_service("web", trusted_proxies="127.0.0.1")
    times = {"proxy_connect_timeout 5s;": "proxy_connect_timeout 1s;", "65m;": "1m;"}
    proxy = start_proxy([web.url], changes=times)
    link = f"{proxy.url}/decode/{web.published(PICTURE)}.png?expires=9&signature=not-for-the-log"
    assert httpx2.get(link, timeout=TIMEOUT_S).status_code == 200
    assert_problem(httpx2.post(f"{proxy.url}/decode.png", content=bytes(2 << 20), timeout=TIMEOUT_S), 413)
    web.stop()
    answer = httpx2.get(link, timeout=TIMEOUT_S)
    assert_problem(answer, 503)
    assert answer.headers["retry-after"]
    logs = {name: (proxy.folder / f"{name}.log").read_text() for name in ("access", "error")}
    assert logs["access"].count(f"GET {urlsplit(link).path} HTTP") == 2
    assert "not-for-the-log" not in "".join(logs.values())
    assert "warn" not in logs["error"]


def test_everything_restarts(
    tmp_path: Path, start_proxy: StartProxy, start_service: StartService, postgres: PostgresServer, own_s3: S3Server
) -> None:
    """While a client encodes in bulk, the database, the store, a web process and the worker end and come back: each
    picture is there in the end, once.
    """
    shared = {"database_url": postgres.new_database(), "storage_url": own_s3.new_storage(), "lease_s": 2}
    shared |= {"trusted_proxies": "127.0.0.1", "extra": {**own_s3.environment, **FAKE_CODEC}}
    webs = [start_service(command, **shared) for command in ("serve", "web")]
    root = start_proxy([web.url for web in webs]).url
    rows: list[Row] = []

    def encode() -> None:
        with client.Client(root, patience_s=TIMEOUT_S) as ours:
            items = [(str(number), SMALL) for number in range(PICTURES)]
            encode_many(ours, items, tmp_path / "out", jobs=4, on_row=lambda row, _: rows.append(row), time_limit_s=0.5)

    bulk = threading.Thread(target=encode)
    bulk.start()
    for trouble in (
        lambda: (own_s3.stop(), time.sleep(1), own_s3.start()),
        lambda: (postgres.stop("immediate"), time.sleep(1), postgres.start()),
        lambda: os.kill(webs[0].ours("worker")[0], signal.SIGKILL),
        lambda: os.kill(webs[0].ours("web")[0], signal.SIGKILL),
    ):
        before = len(rows)
        wait_until(lambda before=before: len(rows) >= before + 2)
        trouble()
    bulk.join(TIMEOUT_S)
    assert not bulk.is_alive()
    assert [row.error for row in rows if row.error] == []
    names = sorted(f"{number}.sg" for number in range(PICTURES))
    assert sorted(row.name for row in rows) == names
    assert len({(tmp_path / "out" / name).read_bytes() for name in names}) == 1


def test_the_page_works(behind: str, browser: Chromium) -> None:
    """Its scripts, a sample, an encode, and the page of requests."""
    browser.complaints()
    browser.open(f"{behind}/")
    wait_until(lambda: browser.is_seen("#right-label") and browser.is_seen("#left-label"))
    browser.run("document.getElementById('more').open = true; document.getElementById('time-limit').value = '0.1'")
    browser.give("drop", SMALL, "one.png")
    wait_until(lambda: len(browser.run("return location.hash")) == len("#") + 32)
    command = "return document.getElementById('curl').textContent"
    wait_until(lambda: browser.run(command).endswith("one.sg"))
    assert f"'{behind}/encode?wait=50'" in browser.run(command)
    assert browser.complaints() == []
    browser.open(f"{behind}/docs")
    wait_until(lambda: browser.run("return document.querySelectorAll('#operations details').length > 1"))
    assert browser.run(f"return document.body.textContent.includes('{behind}/encode?wait=50')")
    browser.open("about:blank")
