"""A real service: started, watched, stopped and killed; and for tests also asked, answered and worked for."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import re
import signal
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import httpx2

import sgmethod
from service.errors import JobTableError
from service.jobs.job import EncodeResult, ImageView, Job, JobError
from service.jobs.table import JobTable
from service.keys import digest
from service.opening import open_job_table, open_storage
from service.settings import Settings
from service.storage.files import bitstream_key
from tests.support.data import ROOT
from tests.support.job_table import IMAGE, settings, submitted
from tests.support.pictures import SLOW, SMALL
from tests.support.processes import TIMEOUT_S, Kind, Outcome, Process, processes, wait_until

SMALL_QUEUE = 5
_FOLDERS = (str(ROOT / "tests" / "support" / "child"), os.environ.get("PYTHONPATH", ""))
CHILD = {"PYTHONPATH": os.pathsep.join(filter(None, _FOLDERS))}
# The environment of a service whose encodes take their time limit and no core, for tests of what stands around them.
FAKE_CODEC = {**CHILD, "PYTHON_FAKE_CODEC": "1"}


def environment_of(**settings: Any) -> dict[str, str]:
    """The environment of a service with these settings, and constants of the settings."""
    constants = json.dumps({name: settings.pop(name) for name in Settings.__class_vars__ & settings.keys()})
    chosen = {f"SG_{name}".upper(): str(value) for name, value in settings.items()}
    return {**os.environ, **CHILD, "TEST_CONSTANTS": constants, **chosen}


class ServiceProcess:
    """One `python -m service`, started at once, and a client of it.

    Give settings and their constants by name, such as queue_length=2, and keys as api_keys; extra: more environment
    variables. What it writes is appended to a log beside its data folder.
    """

    timeout_s = TIMEOUT_S  # of the client's requests

    def __init__(
        self, data_dir: Path, command: str = "serve", extra: Mapping[str, str] | None = None, **settings: Any
    ) -> None:
        self.data_dir = data_dir
        self.log = data_dir.with_name(data_dir.name + ".log")
        chosen = {"port": 0, "data_dir": data_dir, **settings}
        if (keys := chosen.pop("api_keys", None)) is not None:
            chosen["api_keys_file"] = data_dir.with_name(data_dir.name + ".keys")
            chosen["api_keys_file"].write_text(keys)
        self.environment = {**environment_of(**chosen), **(extra or {})}
        self._command = [sys.executable, "-m", "service", command]
        self.start()

    def start(self) -> None:
        """Start it, again after a stop or kill. It listens when this returns."""
        with self.log.open("a") as log:
            before = log.tell()
            self.process = subprocess.Popen(self._command, cwd=ROOT, env=self.environment, stdout=log, stderr=log)

        def announced() -> re.Match[str] | None:
            ended, said = self.process.poll() is not None, self.log.read_text()[before:]
            found = re.search(r"sgmethod service on ([^,\s]+),", said)
            assert found or not ended, said
            return found

        try:
            found = wait_until(announced)
        except AssertionError:
            self.process.kill()
            self.process.wait()
            raise
        assert found
        self.url = found[1]
        self.client = httpx2.Client(base_url=self.url, timeout=self.timeout_s)

    def wait_ready(self) -> None:
        """Wait until it can do all that it is for, the sandbox too."""
        wait_until(lambda: self.client.get("/readyz").status_code == 200)

    def family(self) -> dict[int, Process]:
        """All its processes that are alive, by number."""
        alive = processes()
        family = {self.process.pid}
        for _ in range(2):  # children, then theirs
            family |= {number for number, process in alive.items() if process.parent in family}
        return {number: alive[number] for number in sorted(family & alive.keys())}

    def ours(self, kind: Kind) -> list[int]:
        """The numbers of its processes of a kind."""
        return [number for number, process in self.family().items() if process.is_a(kind)]

    def sandbox(self) -> int:
        """The number of its sandbox itself: not of a fork, whose number is smaller once the system's begin anew."""
        family, parent = self.family().items(), self.process.pid
        (number,) = (number for number, one in family if one.is_a("sandbox") and one.parent == parent)
        return number

    def stop(self) -> int:
        """Stop it as an operator does; the exit status."""
        self.client.close()
        self.process.terminate()
        return self.process.wait(TIMEOUT_S)

    def kill_all(self) -> None:
        """End every process at once, without a chance to say anything."""
        self.client.close()
        victims = self.family()
        for number in victims:
            with contextlib.suppress(ProcessLookupError):
                os.kill(number, signal.SIGKILL)
        self.process.wait(TIMEOUT_S)
        wait_until(lambda: not victims.keys() & processes().keys())

    def files(self) -> list[str]:
        """What lies in the storage."""
        folders = ("sources", "bitstreams", "unfinished")
        return sorted(f"{f}/{path.name}" for f in folders for path in (self.data_dir / f).iterdir())


class Service(ServiceProcess):
    """One `python -m service` with one worker and short leases, which keeps no image of a finished job.

    With command "web" nothing is ever encoded.
    """

    def __init__(
        self, data_dir: Path, command: str = "serve", extra: Mapping[str, str] | None = None, **settings: Any
    ) -> None:
        lease_s = 1 if command == "serve" else 60  # /readyz fails after four of them without a worker
        chosen = {"workers": 1, "lease_s": lease_s, "source_retention_s": 0, **settings}
        super().__init__(data_dir, command, extra, **chosen)

    def post(self, image: bytes = SMALL, key: str | None = None, **fields: Any) -> httpx2.Response:
        """POST /encode; bpp=1 unless fields say otherwise, and not for long unless they say how long."""
        form = {name: str(value) for name, value in {"time_limit_s": 0.1, **(fields or {"bpp": 1})}.items()}
        headers = {"Idempotency-Key": key} if key else {}
        return self.client.post("/encode", files={"image": ("any.png", image)}, data=form, headers=headers)

    def accepted(self, image: bytes = SMALL, **fields: Any) -> str:
        """The id of a new job."""
        answer = self.post(image, **fields)
        assert answer.status_code == 202, answer.text
        return str(answer.json()["id"])

    def accepted_slow(self, seconds: float = 100) -> str:
        """The id of a new job that takes about so many seconds; far longer than any test waits, by default."""
        return self.accepted(SLOW, bpp=1, time_limit_s=seconds)

    def job(self, job_id: str) -> dict[str, Any]:
        answer = self.client.get(f"/jobs/{job_id}")
        assert answer.status_code == 200, answer.text
        job: dict[str, Any] = answer.json()
        return job

    def wait(self, job_id: str, *states: str) -> dict[str, Any]:
        """The job's status once it is in one of the states; done or failed unless named."""
        wanted = states or ("done", "failed")
        job = wait_until(lambda: (job := self.job(job_id))["state"] in wanted and job)
        assert job
        return job

    def figures(self) -> dict[str, float]:
        """What GET /metrics says, by name and labels."""
        answer = self.client.get("/metrics")
        assert answer.status_code == 200
        assert answer.headers["content-type"].startswith("text/plain")
        lines = [line for line in answer.text.splitlines() if not line.startswith("#")]
        return {name: float(value) for name, value in (line.rsplit(" ", 1) for line in lines)}

    def clear(self) -> None:
        """Remove all jobs; returns when nothing is left of them."""
        while jobs := self.client.get("/jobs?limit=200").json()["jobs"]:
            for job in jobs:
                assert self.client.delete(f"/jobs/{job['id']}").status_code in (204, 404)
        wait_until(lambda: not self.ours("encoder") and self.files() == [])

    def published(self, bitstream: bytes, owner: str | None = None) -> str:
        """The id of a job that is done, with this bitstream as its result; nothing is encoded."""
        info = sgmethod.info(bitstream)
        job_id = self.submitted(ImageView(format="PNG", width=info.width, height=info.height, bytes=10), owner)
        self.publish(job_id, bitstream)
        return job_id

    def submitted(self, image: ImageView = IMAGE, owner: str | None = None) -> str:
        """The id of a new job of which there is no more than its row in the table: nothing was posted."""
        with self.table() as table:
            return submitted(table, image=image, owner=owner)

    def publish(self, job_id: str, bitstream: bytes, **figures: Any) -> None:
        """Do as a worker that has encoded the job, where there is no worker; jobs before it are left running. figures:
        others than those of a bitstream; a file of another `format` needs its size.
        """
        if "format" not in figures:
            info = sgmethod.info(bitstream)
            figures = {"width": info.width, "height": info.height, "gaussians": 9, **figures}
        stats = {"bytes": len(bitstream), "bpp": 1.0, "psnr": 30.0, "ssimulacra2": 60.0, "seconds": 1.0, **figures}
        with self.table() as table:
            claim = self._claimed(table, job_id)
            open_storage(self._settings()).put(bitstream_key(job_id, claim.attempt), bitstream)
            assert table.finish(claim, EncodeResult(hashlib.sha256(bitstream).hexdigest(), stats))

    def refuse(self, job_id: str) -> None:
        """Do as a worker whose codec refuses the job."""
        with self.table() as table:
            assert table.fail(self._claimed(table, job_id), JobError("refused", "it is refused"))

    @contextlib.contextmanager
    def table(self) -> Iterator[JobTable]:
        """Its job table, once the database answers: on a busy machine that may take longer than a service waits."""

        def answers() -> bool:
            with contextlib.suppress(JobTableError):
                table.counts()
                return True
            return False

        with contextlib.closing(open_job_table(self._settings())) as table:
            wait_until(answers)
            yield table

    def _settings(self) -> Settings:
        kept_s = float(self.environment["SG_SOURCE_RETENTION_S"])
        url = self.environment.get("SG_DATABASE_URL", "")
        return settings(data_dir=self.data_dir, database_url=url, source_retention_s=kept_s, queue_length=100_000)

    @staticmethod
    def _claimed(table: JobTable, job_id: str) -> Job:
        while (claim := table.claim("test")) is not None and claim.id != job_id:
            pass  # what other tests left waiting runs forever now
        assert claim is not None
        return claim

    def connect(self) -> socket.socket:
        """A connection over which a test says what it likes."""
        url = httpx2.URL(self.url)
        return socket.create_connection((url.host, url.port or 80), timeout=TIMEOUT_S)

    def raw(self, request: bytes) -> bytes:
        """All that is answered to these bytes until the server closes the connection, even with a reset."""
        with self.connect() as connection:
            answer = b""
            with contextlib.suppress(ConnectionError):
                connection.sendall(request)
                while data := connection.recv(65536):
                    answer += data
            return answer


StartService = Callable[..., Service]


RunCommand = Callable[..., Outcome]


def keys_of(*owners: str) -> str:
    """What api_keys says so that each owner's name is the key."""
    return ",".join(f"{name}:{digest(name)}" for name in owners)


def bearer(key: str) -> dict[str, str]:
    return {"Authorization": f"Bearer {key}"}


def max_age(answer: httpx2.Response) -> int:
    """For how many seconds a client may cache an answer."""
    assert answer.status_code == 200, answer.text
    return int(re.findall(r"max-age=(\d+)", answer.headers["cache-control"])[0])


def assert_problem(answer: httpx2.Response, status: int, *words: str) -> dict[str, Any]:
    """The answer is a problem document of that status whose detail holds the words."""
    assert answer.status_code == status, answer.text
    assert answer.headers["content-type"] == "application/problem+json"
    problem: dict[str, Any] = answer.json()
    assert problem["status"] == status
    assert problem["title"]
    assert re.fullmatch(r"(/\w+)*/docs#\w+", problem["type"])
    for word in words:
        assert word in problem["detail"]
    return problem
