"""The Python client and `sgmethod encode --server`, against a real service and against none."""

from __future__ import annotations

import datetime
import io
import ipaddress
import json
import os
import re
import socket
import ssl
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from PIL import Image

import sgmethod
from service.keys import digest
from sgmethod import Budget
from sgmethod.cli import main as cli
from sgmethod.client import Client
from sgmethod.client import client as client_module
from sgmethod.errors import ServerError
from sgmethod.trace import TracePoint
from tests.harness.data import ROOT, golden_path
from tests.harness.pictures import SMALL
from tests.harness.processes import PATIENCE_S, wait_until
from tests.harness.service import SMALL_QUEUE, STAND_IN, Service, StartService

PICTURE = golden_path("v2-color.sg").read_bytes()


def test_an_encode(service: Service) -> None:
    seen: list[TracePoint] = []
    with Client(service.url) as client:
        encoded = client.encode(SMALL, Budget("bpp", 2), time_limit_s=1, on_progress=seen.append)
    assert sgmethod.decode(encoded.data).shape == (48, 64, 3)
    assert encoded.figures["bytes"] == len(encoded.data)
    assert encoded.trace == seen
    assert service.client.get("/jobs").json()["jobs"] == []  # it cleans up behind itself


def test_a_file_that_came_out_badly(service: Service) -> None:
    """The job says so, as sgmethod.Stats does."""
    with Client(service.url) as client:
        job_id = client.submit(SMALL, Budget("bytes", 13))
        result = client.wait(job_id)["result"]
        client.remove(job_id)
    (warning,) = result["warnings"]
    assert warning.startswith("the file contains only a background")
    assert (result["source_bytes"], result["psnr_missed_db"]) == (len(SMALL), None)


def test_one_request_brings_the_file(service: Service) -> None:
    """Unless somebody wants to see progress."""
    before = watches(service), asked(service, "/bitstreams/{job_id}.sg")
    with Client(service.url) as client:
        encoded = client.encode(SMALL, Budget("bpp", 2), time_limit_s=0.5)
        assert len(sgmethod.decode(encoded.data)) == 48
        assert encoded.figures["bytes"] == len(encoded.data)
        assert encoded.trace
        with pytest.raises(ServerError, match="truncated"):
            client.encode(SMALL[: len(SMALL) // 2], Budget("bpp", 2))
    assert service.client.get("/jobs").json()["jobs"] == []
    assert (watches(service), asked(service, "/bitstreams/{job_id}.sg")) == before


@pytest.mark.thorough
def test_what_is_left_out_is_told(service: Service) -> None:
    file = io.BytesIO()
    Image.new("RGBA", (64, 48), (200, 80, 60, 100)).save(file, "PNG")
    with Client(service.url) as client:
        kept = client.encode(file.getvalue(), Budget("bytes", 200), time_limit_s=0.5)
        laid = client.encode(file.getvalue(), Budget("gaussians", 4), "baseline", time_limit_s=0.5)
    assert (kept.notes, laid.notes) == ([], ["transparency is composited over white"])
    assert "notes" not in laid.figures


@pytest.mark.thorough
def test_what_is_not_done_in_one_request_is_waited_for(web: Service, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(client_module, "WAIT_S", 1)
    before = watches(web)

    def work() -> None:
        wait_until(lambda: watches(web) > before)
        web.publish(web.client.get("/jobs?limit=1").json()["jobs"][0]["id"], PICTURE)

    thread = threading.Thread(target=work)
    thread.start()
    with Client(web.url) as client:
        assert client.encode(SMALL, Budget("bpp", 2)).data == PICTURE
    thread.join()


def test_an_image_that_is_encoded_again(start_service: StartService) -> None:
    web = start_service("web", source_retention_s=1000)
    with Client(web.url) as client:
        first = client.submit(SMALL, Budget("bpp", 2))
        again = client.submit_again(first, Budget("psnr", 30), "paper", time_limit_s=9)
        assert client.job(again)["budget"] == {"kind": "psnr", "value": 30}
        assert client.job(again)["image"] == client.job(first)["image"]
        with pytest.raises(ServerError, match="no result to keep"):
            client.stop(again)
        client.remove(first)
        with pytest.raises(ServerError, match="no such job"):
            client.submit_again(first, Budget("bpp", 1))


@pytest.mark.thorough
def test_step_by_step(service: Service) -> None:
    with Client(service.url) as client:
        job_id = client.submit(SMALL, Budget("bpp", 2), "paper", time_limit_s=0.5, priority="bulk")
        assert client.job(job_id)["profile"] == "paper"
        assert client.wait(job_id)["state"] == "done"
        pixels = sgmethod.decode(client.bitstream(job_id))
        assert client.picture(job_id, scale=0.5, region="0,0,64,48") != client.picture(job_id)
        assert client.picture(job_id, "jpg")[:3] == b"\xff\xd8\xff"
        assert pixels.shape == (48, 64, 3)
        client.stop(job_id)  # nothing is left to do
        client.remove(job_id)
        with pytest.raises(ServerError, match="no such job"):
            client.job(job_id)


def test_what_the_server_refuses(service: Service) -> None:
    with Client(service.url) as client:
        with pytest.raises(ServerError, match="not a PNG"):
            client.submit(b"hello", Budget("bpp", 1))
        with pytest.raises(ServerError, match="bytes"):
            client.encode(SMALL, Budget("bytes", 1))
        with pytest.raises(ServerError, match="no such job"):
            client.wait("0" * 32)


def test_a_job_that_somebody_removes(web: Service) -> None:
    with Client(web.url) as client:
        job_id = client.submit(SMALL, Budget("bpp", 1))
        before = watches(web)

        def remove() -> None:
            wait_until(lambda: watches(web) > before)
            web.client.delete(f"/jobs/{job_id}")

        thread = threading.Thread(target=remove)
        thread.start()
        with pytest.raises(ServerError, match="removed"):
            client.wait(job_id)
        thread.join()


def watches(web: Service) -> float:
    """How many streams of events have begun."""
    return asked(web, "/jobs/{job_id}/events")


def asked(web: Service, route: str) -> float:
    """How often it was, with success."""
    return web.figures().get(f'sgmethod_requests_total{{method="GET",route="{route}",status="200"}}', 0)


def fail_to_sleep(seconds: float) -> None:
    raise AssertionError(f"waits for {seconds} s")


def test_what_cannot_pass_is_said_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(time, "sleep", fail_to_sleep)
    for wrong in ("", "nonsense", "127.0.0.1:8000", "localhost:8000", "ftp://127.0.0.1", "http://"):
        with pytest.raises(ServerError, match="must begin with http:// or https://"):
            Client(wrong)
    with pytest.raises(ServerError), Client("http://[") as client:
        client.job("0" * 32)
    with pytest.raises(ServerError, match="is not a valid address"):
        Client("http://two..dots")
    with socket.socket() as nobody:  # holds the port and does not listen
        nobody.bind(("127.0.0.1", 0))
        address = f"http://127.0.0.1:{nobody.getsockname()[1]}"
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
        ("HTTP_PROXY", "ftp://user:secret@host"),
        ("https_proxy", "http://user:secret"),
        ("ALL_PROXY", "socks5://user:secret@host:1080"),
        ("HTTPS_PROXY", "http://secret..host"),
        ("NO_PROXY", "localhost,[::1"),
        ("SSL_CERT_FILE", "missing.pem"),
        ("SSL_CERT_FILE", __file__),
        ("SSL_CERT_DIR", "missing"),
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
    assert cli.main(["encode", *names, "--output-dir", str(tmp_path / "out"), "--server", "http://127.0.0.1:9"]) == 2
    said = capfd.readouterr().err
    assert re.fullmatch(rf"sgmethod: .*{name}.*\n", said)
    assert "secret" not in said


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
            lambda: next(client.jobs()),
            lambda: client.links("0" * 32),
        ):
            with pytest.raises(ServerError, match="is not an sgmethod service"):
                ask()
        with pytest.raises(ServerError, match="text/event-stream"):
            client.wait("0" * 32)
        by_tls = Client(address.replace("http:", "https:"))
        with by_tls, pytest.raises(ServerError, match="SSL"):
            by_tls.job("0" * 32)


def test_a_certificate_that_is_not_trusted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    certificate = tmp_path / "certificate.pem"
    certificate.write_bytes(self_signed())
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(certificate)
    with other(context) as address:
        with monkeypatch.context() as patch, Client(address) as client:
            patch.setattr(time, "sleep", fail_to_sleep)
            with pytest.raises(ServerError, match=f"the certificate of {address} is not trusted; SSL_CERT_FILE"):
                client.submit(SMALL)
        monkeypatch.setenv("SSL_CERT_FILE", str(certificate))
        with Client(address) as client, pytest.raises(ServerError, match="is not an sgmethod service"):
            client.submit(SMALL)


def self_signed() -> bytes:
    """A key and a certificate of 127.0.0.1 that nobody has signed but itself."""
    key = ec.generate_private_key(ec.SECP256R1())
    name = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, "test")])
    now = datetime.datetime.now(datetime.UTC)
    certificate = (
        x509.CertificateBuilder()
        .subject_name(name)
        .issuer_name(name)
        .public_key(key.public_key())
        .serial_number(1)
        .not_valid_before(now - datetime.timedelta(days=1))
        .not_valid_after(now + datetime.timedelta(days=1))
        .add_extension(x509.SubjectAlternativeName([x509.IPAddress(ipaddress.ip_address("127.0.0.1"))]), critical=False)
        .sign(key, hashes.SHA256())
    )
    pem = serialization.Encoding.PEM
    plain = serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    return key.private_bytes(pem, *plain) + certificate.public_bytes(pem)


def test_what_is_tried_again_is_said(caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch) -> None:
    """By default in the log, which Python shows on stderr."""
    monkeypatch.setattr(time, "sleep", lambda _: None)
    told: list[str] = []
    with other() as address:
        patient, quiet = Client(address, patience_s=5), Client(address, patience_s=5, on_retry=told.append)
        for client in (patient, quiet):
            assert client.bitstream("0" * 32)  # it has answered, so that it may come back
    with patient, quiet:
        for client in (patient, quiet):
            with pytest.raises(ServerError, match="cannot be reached"):
                client.job("0" * 32)
            with pytest.raises(ServerError, match="cannot be reached"):
                client.wait("0" * 32)
    assert [text.rpartition("; ")[2] for text in told] == [f"trying again in {pause} s" for pause in (1, 2, 4)] * 2
    assert all(text.startswith(f"{address} cannot be reached: ") for text in told)
    assert [record.getMessage() for record in caplog.records if record.name == "sgmethod.client"] == told


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


def test_the_command_line_says_what_it_tries_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(time, "sleep", lambda _: None)
    (tmp_path / "in.png").write_bytes(SMALL)
    refused = "the server refused: no such picture"
    tries = [f"sgmethod: {refused}; trying again in {pause} s" for pause in (1, 2)]
    with other(handler=Busy) as address:
        for extra, said in (([], tries), (["--quiet"], [])):
            names = [str(tmp_path / name) for name in ("in.png", "out.sg")]
            assert cli.main(["encode", *names, "--server", address, *extra]) == 2
            assert capfd.readouterr().err.splitlines() == [*said, f"sgmethod: {refused}"]


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
    web = empty
    first, *_ = [web.accepted() for _ in range(SMALL_QUEUE)]
    with Client(web.url, patience_s=0) as hasty, pytest.raises(ServerError, match="full"):
        hasty.submit(SMALL, Budget("bpp", 1))
    threading.Timer(0.5, lambda: web.client.delete(f"/jobs/{first}")).start()
    told: list[str] = []
    with Client(web.url, patience_s=60, on_retry=told.append) as patient:
        assert patient.submit(SMALL, Budget("bpp", 1)) != first
    assert "full" in told[0]


@pytest.mark.thorough
def test_a_service_that_restarts_meanwhile(start_service: StartService) -> None:
    web = start_service("web")
    told: list[str] = []
    with Client(web.url, on_retry=told.append) as client:
        job_id = client.submit(SMALL, Budget("bpp", 2))
        port = web.url.rpartition(":")[2]

        def restart() -> None:
            wait_until(lambda: watches(web) == 1)
            web.stop()
            web.environment["SG_PORT"] = port
            web.start()
            wait_until(lambda: watches(web) == 1)
            web.publish(job_id, PICTURE)

        thread = threading.Thread(target=restart)
        thread.start()
        assert client.wait(job_id)["state"] == "done"
        thread.join()
    assert told
    assert all("trying again in" in text for text in told)


def test_the_command_line(start_service: StartService, tmp_path: Path) -> None:
    service = start_service(api_keys=f"ann:{digest('secret')}", extra=STAND_IN)
    (tmp_path / "in.png").write_bytes(SMALL)

    def encode(*arguments: str, key: str = "secret") -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-m", "sgmethod", "encode", "in.png", "out.sg", "--server", service.url]
        environment = {**os.environ, "SG_API_KEY": key, "PYTHONPATH": str(ROOT)}
        everything = [*command, "--time-limit", "1", *arguments]
        return subprocess.run(
            everything, cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=PATIENCE_S, check=False
        )

    done = encode("--bpp", "2", "--json", "--trace", "trace.json")
    assert (done.returncode, done.stderr) == (0, "")
    figures = json.loads(done.stdout)
    data = (tmp_path / "out.sg").read_bytes()
    assert figures["bytes"] == len(data)
    assert sgmethod.info(data).width == 64
    trace = json.loads((tmp_path / "trace.json").read_text())
    assert trace["stats"] == figures
    assert trace["trace"]

    (tmp_path / "out.sg").unlink()
    for refused, words in ((encode(key="wrong"), "unknown API key; set SG_API_KEY"), (encode("--seed", "1"), "--seed")):
        assert refused.returncode == 2
        assert words in refused.stderr
        assert refused.stderr.count("\n") == 1
        assert not (tmp_path / "out.sg").exists()


@pytest.mark.thorough
def test_all_that_a_client_may_ask(start_service: StartService) -> None:
    web = start_service("web", link_secret="s" * 32)
    with Client(web.url) as client:
        first, second = (client.submit(SMALL, priority="bulk") for _ in range(2))
        web.publish(first, PICTURE)
        assert [job["id"] for job in client.jobs()] == [second, first]
        assert [job["id"] for job in client.jobs("done")] == [first]
        assert next(client.jobs("queued"))["budget"] == {"kind": "bpp", "value": 0.3}
        assert client.decode(PICTURE, "webp", width=32) == client.picture(first, "webp", width=32)
        assert client.bitstream(first) == PICTURE
        assert web.client.get(client.links(first, 60)["bitstream_url"]).content == PICTURE
        with pytest.raises(ServerError, match=r"expires_s.*604800"):
            client.links(first, 10**9)
