"""Services for the tests: one of a test's own, or one shared by a module."""

from __future__ import annotations

import logging
import signal
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest

from service.__main__ import main
from service.jobs.table import JobTable
from tests.conftest import missing
from tests.service.s3_server import S3Server
from tests.support import nginx, postgres_server
from tests.support.data import PICTURE
from tests.support.job_table import LONG_S, OpenTable, open_table
from tests.support.nginx import Nginx
from tests.support.postgres_server import PostgresServer, find_binaries
from tests.support.processes import Outcome
from tests.support.service import FAKE_CODEC, SMALL_QUEUE, RunCommand, Service, StartService


@pytest.fixture(scope="session")
def postgres() -> Iterator[PostgresServer]:
    server = PostgresServer(find_binaries() or missing(postgres_server.REQUIRED, postgres_server.HINT))
    yield server
    server.close()


@pytest.fixture(scope="session")
def s3(tmp_path_factory: pytest.TempPathFactory) -> Iterator[S3Server]:
    server = S3Server(tmp_path_factory.mktemp("s3"))
    yield server
    server.stop()


@pytest.fixture
def own_s3(tmp_path: Path) -> Iterator[S3Server]:
    """An S3 server that a test may spoil."""
    server = S3Server(tmp_path / "s3")
    yield server
    server.stop()


@pytest.fixture
def run_command(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Iterator[RunCommand]:
    """Runs `python -m service` within this process, which takes a moment where a process of its own takes a second."""
    handlers = {number: signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGINT)}

    def run(*arguments: str, **settings: object) -> Outcome:
        with monkeypatch.context() as patch:
            patch.setattr(sys, "argv", ["service", *arguments])
            patch.setattr(tempfile, "tempdir", tempfile.tempdir)  # which the web process sets
            for name, value in settings.items():
                patch.setenv(name if name.isupper() else f"SG_{name}".upper(), str(value))
            status = main()
        return Outcome(status, *capsys.readouterr())

    yield run
    for number, handler in handlers.items():
        signal.signal(number, handler)
    # The command's log goes to a closed stream: each request of a later test would leave a traceback there.
    root = logging.getLogger()
    for handler in [each for each in root.handlers if type(each) is logging.StreamHandler]:
        root.removeHandler(handler)
    root.setLevel(logging.WARNING)


@pytest.fixture(scope="session", params=["sqlite", pytest.param("postgresql", marks=pytest.mark.thorough)])
def new_table(request: pytest.FixtureRequest) -> Callable[[], str]:
    """Gives SG_DATABASE_URL of empty job tables: what takes it runs once on either database."""
    if request.param == "sqlite":
        return lambda: "sqlite"
    server: PostgresServer = request.getfixturevalue("postgres")
    return server.new_database


@pytest.fixture
def database_url(new_table: Callable[[], str]) -> str:
    """One that is the test's own."""
    return new_table()


@pytest.fixture
def open_job_table(tmp_path: Path, database_url: str) -> Iterator[OpenTable]:
    """Opens the same table with leases of this many seconds."""
    opened: list[JobTable] = []

    def opener(lease_s: float, **options: Any) -> JobTable:
        opened.append(open_table(database_url, tmp_path, lease_s, **options))
        return opened[-1]

    yield opener
    for table in opened:
        table.close()


@pytest.fixture
def table(open_job_table: OpenTable) -> JobTable:
    return open_job_table(LONG_S)


@pytest.fixture(scope="session")
def certificate(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A certificate for this machine, which clients trust, beside its key."""
    if nginx.NGINX is None:
        missing(nginx.REQUIRED, nginx.HINT)
    file = nginx.make_certificate(tmp_path_factory.mktemp("tls"))
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("SSL_CERT_FILE", str(file))
        yield file


@pytest.fixture(scope="module")
def start_proxy(tmp_path_factory: pytest.TempPathFactory, certificate: Path) -> Iterator[Callable[..., Nginx]]:
    """Starts the documented nginx before web processes: see Nginx."""
    started: list[Nginx] = []

    def start(webs: Sequence[str], *how: Any, **more: Any) -> Nginx:
        started.append(Nginx(tmp_path_factory.mktemp("nginx"), certificate, webs, *how, **more))
        return started[-1]

    yield start
    for proxy in started:
        proxy.stop()


@pytest.fixture
def start_service(tmp_path: Path) -> Iterator[StartService]:
    """Starts services with settings of the test's own; they end after the test."""
    started: list[Service] = []

    def start(command: str = "serve", **settings: Any) -> Service:
        started.append(Service(tmp_path / f"data{len(started)}", command, **settings))
        return started[-1]

    yield start
    for service in started:
        service.client.close()
        if service.process.poll() is None:
            service.stop()


def _start_shared(tmp_path_factory: pytest.TempPathFactory) -> Iterator[StartService]:
    """Starts services that tests share, since they leave them as they found them; each must end well."""
    started: list[Service] = []

    def start(command: str = "serve", **settings: Any) -> Service:
        started.append(Service(tmp_path_factory.mktemp("shared") / "data", command, **settings))
        return started[-1]

    yield start
    for service in started:
        assert service.stop() == 0
        assert "Traceback" not in service.log.read_text()


start_for_all = pytest.fixture(_start_shared, scope="session")
start_for_module = pytest.fixture(_start_shared, scope="module")


@pytest.fixture(scope="session")
def shared_service(start_for_all: StartService) -> Service:
    """A whole service with its defaults."""
    return start_for_all()


@pytest.fixture(scope="module")
def service(shared_service: Service) -> Iterator[Service]:
    """A whole service with its defaults, which has no jobs when a module's tests begin."""
    yield shared_service
    shared_service.clear()


@pytest.fixture(scope="session")
def quick(start_for_all: StartService) -> Service:
    """The same with a fake codec."""
    return start_for_all(extra=FAKE_CODEC)


@pytest.fixture(scope="session")
def small_queue(start_for_all: StartService, new_table: Callable[[], str]) -> Service:
    """A web process without any worker, of whose queue one client may have SMALL_QUEUE places."""
    return start_for_all("web", queue_length=2 * SMALL_QUEUE, database_url=new_table())


@pytest.fixture
def empty(small_queue: Service) -> Service:
    """The same, with no job left of other tests."""
    small_queue.clear()
    return small_queue


@pytest.fixture(scope="session")
def web(start_for_all: StartService) -> Service:
    """A web process without any worker, with small limits, shared by all tests that leave it able to serve."""
    return start_for_all("web", max_upload_bytes=200_000, max_pixels=1_000_000, queue_length=10_000)


@pytest.fixture(scope="session")
def keeping(start_for_all: StartService) -> Service:
    """A web process without any worker that keeps the images of finished jobs."""
    return start_for_all("web", source_retention_s=1000)


@pytest.fixture(scope="module")
def done(web: Service) -> str:
    """The id of a job that is done."""
    return web.published(PICTURE)
