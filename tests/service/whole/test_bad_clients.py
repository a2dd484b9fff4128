"""Clients that do not keep to HTTP, or hold connections: nginx, set up by docs/nginx.conf, turns them away, and the
service never hears of them. Everybody else is served meanwhile.
"""

from __future__ import annotations

import contextlib
import socket
import ssl
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

import httpx2
import pytest

from tests.support.data import PICTURE
from tests.support.nginx import Nginx
from tests.support.pictures import SMALL
from tests.support.processes import TIMEOUT_S, wait_until
from tests.support.service import Service, StartService

pytestmark = pytest.mark.thorough

HEAD = b"Host: localhost\r\nConnection: close\r\n"
GET, POST = b"GET /livez HTTP/1.1\r\n" + HEAD, b"POST /encode?bpp=1 HTTP/1.1\r\nContent-Type: image/png\r\n" + HEAD
IMPATIENT = {f"{name} 10s": f"{name} 1s" for name in ("client_header_timeout", "client_body_timeout")}
CONNECTIONS, REQUESTS = 100, 300  # of one address, at once


@pytest.fixture(scope="module")
def behind(start_for_module: StartService, start_proxy: Any) -> tuple[Service, Nginx]:
    """A web process, and the documented nginx in front of it, which waits for less long."""
    service = start_for_module("web", trusted_proxies="127.0.0.1", queue_length=10_000)
    changes = {**IMPATIENT, "send_timeout 60s": "send_timeout 1s"}
    return service, start_proxy([service.url], changes=changes)


@pytest.fixture(scope="module")
def patient(behind: tuple[Service, Nginx], start_proxy: Any) -> tuple[Service, Nginx]:
    """The same service behind nginx with the times of the document: a busy machine may take a second for a crowd."""
    return behind[0], start_proxy([behind[0].url])


def somebody_else(proxy: Nginx) -> httpx2.Client:
    transport = httpx2.HTTPTransport(local_address="127.0.0.2", verify=ssl.create_default_context())
    return httpx2.Client(base_url=proxy.url, transport=transport, timeout=TIMEOUT_S)


@pytest.fixture(scope="module")
def other(behind: tuple[Service, Nginx]) -> Iterator[httpx2.Client]:
    with somebody_else(behind[1]) as client:
        yield client


def connected(proxy: Nginx) -> ssl.SSLSocket:
    """A connection over which a test says what it likes."""
    context = ssl.create_default_context()  # before nginx waits for what is said
    raw = socket.create_connection(("127.0.0.1", proxy.port), timeout=TIMEOUT_S)
    return context.wrap_socket(raw, server_hostname="127.0.0.1")


def status_of(behind: tuple[Service, Nginx], request: bytes) -> int:
    """The status of what is answered to these bytes; 0 for none, or one that went under in a reset."""
    answer = b""
    with connected(behind[1]) as connection:
        with contextlib.suppress(OSError):
            connection.sendall(request)
        with contextlib.suppress(OSError):
            while data := connection.recv(65536):
                answer += data
    words = answer.split(maxsplit=2)
    return int(words[1]) if len(words) > 1 else 0


ATTACKS = {
    "nothing sent": (b"", 0),
    "a head that ends early": (b"GET /livez HTTP/1.1\r\nX: y\r\n", 408),
    "a body that never starts": (POST + b"Content-Length: 5000\r\n\r\n", 408),
    "a body that ends early": (POST + b"Content-Length: 5000\r\n\r\n" + SMALL[:1000], 408),
    "a chunk that ends early": (POST + b"Transfer-Encoding: chunked\r\n\r\n5\r\nx", 408),
    "a large body": (POST + b"Content-Length: 999999999999\r\n\r\n", 413),
}


@pytest.mark.parametrize("attack", ATTACKS)
def test_what_nginx_answers(behind: tuple[Service, Nginx], attack: str) -> None:
    request, status = ATTACKS[attack]
    assert status_of(behind, request) in (status, 0)
    assert status_of(behind, GET + b"\r\n") == 200


@pytest.mark.parametrize("drip", [b"X-A: b\r\n", b"x"])
def test_heads_that_trickle(behind: tuple[Service, Nginx], drip: bytes) -> None:
    """The time is one for the whole head."""
    with connected(behind[1]) as connection:
        connection.sendall(b"GET /livez HTTP/1.1\r\n")
        connection.settimeout(0.1)

        def is_over() -> bool:
            try:
                connection.sendall(drip)
                return bool(connection.recv(65536)) or True
            except TimeoutError:
                return False
            except OSError:
                return True

        assert wait_until(is_over)


def test_a_client_that_never_reads(behind: tuple[Service, Nginx]) -> None:
    service, proxy = behind
    done = service.published(PICTURE)
    with connected(proxy) as connection:
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        request = f"GET /decode/{done}.png?width=2000 HTTP/1.1\r\nHost: localhost\r\n\r\n".encode()
        connection.sendall(20 * request)  # more than buffers hold

        def cut_off() -> bool:
            time.sleep(0.1)
            try:
                connection.sendall(b"x")
            except OSError:
                return True
            return False

        assert wait_until(cut_off)


def test_what_a_client_has_not_read_waits_in_the_service(start_proxy: Any) -> None:
    """nginx took a whole answer at once, and kept it on its disk: 60 connections made it hold 255 MB."""
    answer, sent = bytes(30_000_000), threading.Event()  # more than the buffers of connections hold

    class Web(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send_response(200)
            body = answer if self.path == "/large" else b""
            self.send_header("Content-Length", str(len(body)))
            self.end_headers()
            self.wfile.write(body)
            if body:
                sent.set()

        def log_message(self, *_: object) -> None: ...

    web = ThreadingHTTPServer(("127.0.0.1", 0), Web)
    threading.Thread(target=web.serve_forever, daemon=True).start()
    try:
        proxy = start_proxy([f"127.0.0.1:{web.server_port}"])
        with connected(proxy) as connection:
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 65536)
            connection.sendall(b"GET /large HTTP/1.1\r\n" + HEAD + b"\r\n")
            assert not sent.wait(2)
            read = 0
            while data := connection.recv(1 << 20):
                read += len(data)
        assert read > len(answer)
        assert sent.wait(TIMEOUT_S)
    finally:
        web.shutdown()
        web.server_close()


def test_connections_of_one_address_are_limited(patient: tuple[Service, Nginx]) -> None:
    service, proxy = patient
    head = f"Host: localhost\r\nContent-Type: image/png\r\nContent-Length: {len(SMALL)}\r\n\r\n".encode()
    crowd = []
    try:
        for _ in range(CONNECTIONS):
            crowd.append(connected(proxy))
            crowd[-1].sendall(b"POST /encode HTTP/1.1\r\n" + head + SMALL[:10])  # the rest of which never comes
        wait_until(lambda: status_of((service, proxy), GET + b"\r\n") == 429)
        with somebody_else(proxy) as other:
            assert other.get("/livez").status_code == 200
            assert other.post("/encode?bpp=1", content=SMALL, headers={"Content-Type": "image/*"}).status_code == 202
    finally:
        for connection in crowd:
            connection.close()
        service.clear()
    assert wait_until(lambda: status_of(patient, GET + b"\r\n") == 200)


def test_requests_of_one_address_are_limited(behind: tuple[Service, Nginx], other: httpx2.Client) -> None:
    """A problem document says so, as the service's own do."""
    with httpx2.Client(base_url=behind[1].url, timeout=TIMEOUT_S) as client, ThreadPoolExecutor(4) as pool:
        answers = list(pool.map(lambda _: client.get("/livez"), range(4 * REQUESTS)))
        assert {answer.status_code for answer in answers} == {200, 429}
        assert sum(answer.is_success for answer in answers) >= REQUESTS / 2  # earlier tests have had some of them
        assert all(other.get("/livez").is_success for _ in range(20))
    refused = next(answer for answer in answers if answer.status_code == 429)
    assert (refused.json()["status"], refused.headers["retry-after"]) == (429, "1")
    assert refused.headers["content-type"] == "application/problem+json"
