"""The Python client and `sgmethod encode --server`, where there is no service."""

from __future__ import annotations

import re
import socket
import ssl
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest

from sgmethod import Budget
from sgmethod.cli import main as cli
from sgmethod.client import Client
from sgmethod.errors import ServerError
from tests.support.nginx import make_certificate
from tests.support.pictures import SMALL


def fail_to_sleep(seconds: float) -> None:
    raise AssertionError(f"waits for {seconds} s")


def test_permanent_errors_are_raised_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(time, "sleep", fail_to_sleep)
    for wrong in ("", "nonsense", "127.0.0.1:8000", "localhost:8000", "ftp://127.0.0.1", "http://"):
        with pytest.raises(ServerError, match="must begin with http:// or https://"):
            Client(wrong)
    with pytest.raises(ServerError), Client("http://[") as client:
        client.job("0" * 32)
    with pytest.raises(ServerError, match="is not a valid address"):
        Client("http://two..dots")
    with socket.socket() as silent:  # holds the port and does not listen
        silent.bind(("127.0.0.1", 0))
        address = f"http://127.0.0.1:{silent.getsockname()[1]}"
        with Client(address) as client:
            with pytest.raises(ServerError, match=f"{address} cannot be reached: .*refused"):
                client.submit(SMALL, Budget("bpp", 1))
            with pytest.raises(ServerError, match="cannot be reached"):
                client.wait("0" * 32)
    for key in ("key\n", "schlüssel"):
        with pytest.raises(ServerError, match="the API key contains a line break"):
            Client("http://127.0.0.1:8000", key)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("HTTPS_PROXY", "ftp://user:secret@host"),
        ("HTTP_PROXY", "http://user:secret"),
        ("ALL_PROXY", "socks5://user:secret@host:1080"),
        ("SSL_CERT_FILE", "missing.pem"),
        ("SSL_CERT_FILE", __file__),
        ("SSLKEYLOGFILE", "missing/keys"),
        ("SG_API_KEY", "secret\n"),
    ],
)
def test_an_environment_that_cannot_be_used(
    name: str, value: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """One sentence that names the variable, however many pictures there are, and repeats no secret."""
    monkeypatch.setenv(name, value)
    monkeypatch.setitem(sys.modules, "socksio", None)
    names = [str(tmp_path / f"{name}.png") for name in "ab"]
    assert cli.main(["encode", *names, "--output-dir", str(tmp_path / "out"), "--server", "https://127.0.0.1:9"]) == 2
    output = capfd.readouterr().err
    assert re.fullmatch(rf"sgmethod: .*{name}.*\n", output)
    assert "secret" not in output


def test_a_server_is_asked_through_its_proxy(monkeypatch: pytest.MonkeyPatch) -> None:
    with other() as proxy:
        monkeypatch.setenv("http_proxy", proxy.removeprefix("http://"))
        with Client("http://service.invalid") as client, pytest.raises(ServerError, match="is not an sgmethod service"):
            client.job("0" * 32)


class Other(BaseHTTPRequestHandler):
    """A server of something else."""

    def do_GET(self) -> None:
        self.send_response(200)
        self.send_header("Content-Type", "text/html")
        self.end_headers()
        self.wfile.write(b"<h1>Welcome</h1>")

    def do_POST(self) -> None:
        self.rfile.read(int(self.headers["Content-Length"]))
        self.do_GET()

    def log_message(self, *_: object) -> None:
        """Nothing."""


@contextmanager
def other(context: ssl.SSLContext | None = None, handler: type[Other] = Other) -> Iterator[str]:
    """The address of such a server, by TLS if there is a context."""
    with ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        if context is not None:
            server.socket = context.wrap_socket(server.socket, server_side=True, do_handshake_on_connect=False)
        threading.Thread(target=server.serve_forever).start()
        yield f"http{'s' if context else ''}://127.0.0.1:{server.server_port}"
        server.shutdown()


def test_a_server_of_something_else(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(time, "sleep", fail_to_sleep)
    with other() as address, Client(address) as client:
        for ask in (
            lambda: client.submit(SMALL),
            lambda: client.encode(SMALL),
            lambda: client.job("0" * 32),
            lambda: client.wait("0" * 32),
            lambda: next(client.jobs()),
            lambda: client.links("0" * 32),
        ):
            with pytest.raises(ServerError, match="is not an sgmethod service"):
                ask()
        by_tls = Client(address.replace("http:", "https:"))
        with by_tls, pytest.raises(ServerError, match="SSL"):
            by_tls.job("0" * 32)


def test_a_certificate_that_is_not_trusted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    certificate, context = make_certificate(tmp_path), ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(certificate, tmp_path / "key.pem")
    with other(context) as address:
        with monkeypatch.context() as patch, Client(address) as client:
            patch.setattr(time, "sleep", fail_to_sleep)
            with pytest.raises(ServerError, match=f"the certificate of {address} is not trusted; SSL_CERT_FILE"):
                client.submit(SMALL)
        monkeypatch.setenv("SSL_CERT_FILE", str(certificate))
        with Client(address) as client, pytest.raises(ServerError, match="is not an sgmethod service"):
            client.submit(SMALL)


def test_retries_are_logged(caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch) -> None:
    """By default in the log, which Python shows on stderr."""
    monkeypatch.setattr(time, "sleep", lambda _: None)
    messages: list[str] = []
    with other() as address:
        patient, quiet = Client(address, patience_s=5), Client(address, patience_s=5, on_retry=messages.append)
        for client in (patient, quiet):
            assert client.bitstream("0" * 32)  # it has answered, so that it may come back
    with patient, quiet:
        for client in (patient, quiet):
            with pytest.raises(ServerError, match="cannot be reached"):
                client.job("0" * 32)
            with pytest.raises(ServerError, match="cannot be reached"):
                client.wait("0" * 32)
    assert [text.rpartition("; ")[2] for text in messages] == [f"trying again in {pause} s" for pause in (1, 2, 4)] * 2
    assert all(text.startswith(f"{address} cannot be reached: ") for text in messages)
    assert [record.getMessage() for record in caplog.records if record.name == "sgmethod.client"] == messages


class Busy(Other):
    """A service that is busy twice, and then refuses."""

    asked = 0

    def do_POST(self) -> None:
        self.rfile.read(int(self.headers["Content-Length"]))
        type(self).asked += 1
        detail = b'{"detail": "no such picture"}'
        self.send_response(422 if self.asked % 3 == 0 else 503)
        self.send_header("Content-Length", str(len(detail)))
        self.end_headers()
        self.wfile.write(detail)


def test_the_command_line_reports_retries(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(time, "sleep", lambda _: None)
    (tmp_path / "in.png").write_bytes(SMALL)
    refused = "the server refused: no such picture"
    tries = [f"sgmethod: {refused}; trying again in {pause} s" for pause in (1, 2)]
    with other(handler=Busy) as address:
        for extra, lines in (([], tries), (["--quiet"], [])):
            names = [str(tmp_path / name) for name in ("in.png", "out.sg")]
            assert cli.main(["encode", *names, "--server", address, *extra]) == 2
            assert capfd.readouterr().err.splitlines() == [*lines, f"sgmethod: {refused}"]
