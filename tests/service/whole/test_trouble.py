"""Trouble around the service: a full disk, a database that restarts, machines that come and go, stray processes."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import httpx2
import pytest
from PIL import Image

from service.api.context import WORK_THREADS
from service.api.health import THREADS
from service.storage.bucket import SILENCE
from tests.service.s3_server import S3Server
from tests.support.data import PICTURE, ROOT
from tests.support.pictures import noisy_png, saved
from tests.support.postgres_server import PostgresServer
from tests.support.processes import TIMEOUT_S, encoder_of, end_early, processes, running_encoder, wait_until, worker_of
from tests.support.service import FAKE_CODEC, StartService, assert_problem

pytestmark = pytest.mark.thorough

DISK_BYTES, UPLOAD_BYTES = 2**24, 2**21  # of the file system; of one upload, four times which must be free
SOON_S = 4 * SILENCE.total_seconds()  # on a busy machine


def mount(*options: str) -> None:
    """Mount something, or skip the test."""
    if subprocess.run(["mount", *options], capture_output=True, check=False).returncode:
        pytest.skip("a file system cannot be mounted here, so its trouble was not tested: run the tests as root")


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A file system of its own, with little space, where services keep their data."""
    folder = tmp_path / "data0"
    folder.mkdir()
    mount("-t", "tmpfs", "-o", f"size={DISK_BYTES}", "tmpfs", str(folder))
    yield folder
    subprocess.run(["umount", "--lazy", str(folder)], check=True)


def fill(disk: Path) -> Path:
    """Leave no space at all; the file that takes it."""
    ballast = disk / "ballast"
    with ballast.open("wb", buffering=0) as file:
        for size in (65536, 4096, 1):
            try:
                while file.write(bytes(size)):
                    pass
            except OSError:
                continue
    return ballast


def test_full_disk_while_accepting(small_disk: Path, start_service: StartService, database_url: str) -> None:
    """Rule 1: what cannot be kept is not accepted, and nothing of it stays. What stores nothing or makes room works."""
    web = start_service("web", database_url=database_url, max_upload_bytes=UPLOAD_BYTES)
    done = web.published(PICTURE)
    before = web.files()
    ballast = fill(small_disk)
    assert_problem(web.post(), 503)
    assert web.files() == before
    manifests = "".join(file.read_text() for file in (ROOT / "docs" / "kubernetes").glob("*.yaml"))
    probes = re.findall(r"readinessProbe:\s*httpGet: \{ path: (\S+),", manifests)
    assert len(probes) == 2  # without which no request would come here
    for path in (f"/jobs/{done}", f"/decode/{done}.png", *probes):
        assert web.client.get(path).status_code == 200
    assert web.client.post("/decode.png", content=PICTURE).status_code == 200
    assert web.client.delete(f"/jobs/{done}").status_code == 204
    assert web.files() == []
    ballast.unlink()
    job_id = web.accepted()
    assert web.files() == [f"sources/{job_id}"]


def test_full_disk_while_finishing(small_disk: Path, start_service: StartService, database_url: str) -> None:
    """A result waits for space; the encode is not done again."""
    service = start_service(database_url=database_url, lease_s=30, max_upload_bytes=UPLOAD_BYTES, extra=FAKE_CODEC)
    job_id = service.accepted_slow()
    encoder = running_encoder(job_id)
    ballast = fill(small_disk)
    end_early(encoder)
    wait_until(lambda: "cannot be stored yet" in service.log.read_text())
    assert service.job(job_id)["state"] == "running"
    ballast.unlink()
    job = service.wait(job_id)
    assert (job["state"], job["attempt"]) == ("done", 1)
    wait_until(lambda: service.files() == [f"bitstreams/{job_id}.1.sg"])


def test_a_disk_that_becomes_read_only(start_service: StartService) -> None:
    """As after an error of the disk. What can only be read is not ready."""
    web = start_service("web")
    done = web.published(PICTURE)
    mount("--bind", str(web.data_dir), str(web.data_dir))
    try:
        mount("-o", "remount,bind,ro", str(web.data_dir))
        assert_problem(web.post(), 503)
        assert_problem(web.client.get("/readyz"), 503, "takes no changes")
        assert web.figures()["sgmethod_job_table_up"] == 0
        assert web.client.get(f"/decode/{done}.png").status_code == 200
    finally:
        subprocess.run(["umount", "--lazy", str(web.data_dir)], check=True)
    assert web.client.get("/readyz").status_code == 200
    web.accepted()


def test_rule_7_a_database_that_restarts(start_service: StartService, postgres: PostgresServer) -> None:
    """An encode goes on meanwhile, its result is published afterwards, and new jobs find their workers."""
    service = start_service(database_url=postgres.new_database(), lease_s=20, extra=FAKE_CODEC)
    job_id = service.accepted_slow()
    encoder = running_encoder(job_id)
    postgres.stop("immediate")
    try:
        wait_until(lambda: f"job {job_id}: no heartbeat" in service.log.read_text())
    finally:
        postgres.start()
    end_early(encoder)
    job = service.wait(job_id)
    assert (job["state"], job["attempt"]) == ("done", 1)
    assert service.wait(service.accepted())["attempt"] == 1
    wait_until(lambda: len(service.files()) == 2)


def test_the_end_does_not_wait_for_a_database(start_service: StartService, postgres: PostgresServer) -> None:
    grace_s = TIMEOUT_S / 2  # in which no database comes back
    service = start_service(database_url=postgres.new_database(), stop_grace_s=grace_s)
    service.wait_ready()  # its sandbox takes seconds to start
    wait_until(lambda: ": ready," in service.log.read_text())
    postgres.stop("immediate")
    try:
        assert service.client.get("/readyz").status_code == 503
        assert service.stop() == 0
    finally:
        postgres.start()
    log = service.log.read_text()
    assert "is killed" not in log
    assert "Traceback" not in log


def test_a_storage_that_breaks(start_service: StartService) -> None:
    """Unreachable files are a 503, lost ones a 500, and the job can still be removed."""
    web = start_service("web")
    lost, unreachable = (web.published(PICTURE) for _ in range(2))
    folder = web.data_dir / "bitstreams"
    (folder / f"{lost}.1.sg").unlink()
    assert_problem(web.client.get(f"/bitstreams/{lost}.sg"), 500, "missing")
    assert_problem(web.client.get(f"/decode/{lost}.png"), 500, "missing")
    folder.rename(web.data_dir / "aside")
    folder.write_bytes(b"")
    for path in (f"/bitstreams/{unreachable}.sg", f"/decode/{unreachable}.png"):
        answer = web.client.get(path)
        assert_problem(answer, 503, "storage")
        assert answer.headers["retry-after"]
    assert web.client.delete(f"/jobs/{unreachable}").status_code == 204
    assert web.client.get(f"/jobs/{unreachable}").status_code == 404
    assert "Traceback" not in web.log.read_text()


@pytest.mark.parametrize("command", ["serve", "worker"])
def test_a_worker_that_hangs(command: str, start_service: StartService) -> None:
    """It was never restarted. With `worker`, it ends, for whoever started it to start another; its sandbox ends it."""
    service = start_service("serve" if command == "serve" else "web", extra=FAKE_CODEC)
    number = service.ours("worker")[0] if command == "serve" else 0
    alone = None
    if command == "worker":
        alone = subprocess.Popen([sys.executable, "-m", "service", "worker"], cwd=ROOT, env=service.environment)
        number = alone.pid
    service.wait(service.accepted())
    os.kill(number, signal.SIGSTOP)
    if alone is None:
        wait_until(lambda: service.ours("worker") not in ([], [number]), 2 * TIMEOUT_S)
        assert service.wait(service.accepted())["state"] == "done"
    else:
        assert alone.wait(2 * TIMEOUT_S) == -signal.SIGKILL
        wait_until(lambda: not [one for one in processes().values() if one.parent == number])


def test_a_storage_that_hangs(start_service: StartService, own_s3: S3Server) -> None:
    """It accepts and never answers. Clients hear so within seconds, whatever the size of what they send or fetch."""
    settings = {"storage_url": own_s3.new_storage(), "source_retention_s": 1000}
    service = start_service(**settings, extra={**own_s3.environment, **FAKE_CODEC})
    done = service.wait(service.accepted())
    own_s3.freeze()
    service.client.timeout = httpx2.Timeout(SOON_S)
    large = noisy_png(700)
    for ask in (
        lambda: service.client.get(done["bitstream_url"]),
        lambda: service.client.get(done["decode_url"]),
        service.post,
        lambda: service.post(large),
    ):
        answer = ask()
        assert_problem(answer, 503, "right now")
        assert answer.headers["retry-after"]
    assert service.client.get(done["status_url"]).status_code == 200


def test_nothing_waits_behind_a_storage_that_hangs(start_service: StartService, own_s3: S3Server) -> None:
    """Though more requests wait for it, probes among them, than there are threads for that."""
    settings = {"storage_url": own_s3.new_storage(), "source_retention_s": 1000}
    service = start_service(**settings, extra={**own_s3.environment, **FAKE_CODEC})
    done = service.wait(service.accepted())
    own_s3.freeze()
    with ThreadPoolExecutor(3 * WORK_THREADS) as pool:
        paths = [done["bitstream_url"]] * 2 * WORK_THREADS + ["/readyz"] * 2 * THREADS
        waiting = [pool.submit(httpx2.get, service.url + path, timeout=TIMEOUT_S) for path in paths]
        wait_until(lambda: any(each.done() for each in waiting))  # the probes lose patience first
        for path in ("/livez", "/", "/static/main.js", "/jobs", done["status_url"]):
            assert httpx2.get(service.url + path, timeout=TIMEOUT_S).status_code == 200
        assert not all(each.done() for each in waiting)  # of which half wait for the others
        assert service.figures()["sgmethod_job_table_up"] == 1
        assert {each.result().status_code for each in waiting} == {503}


def test_workers_that_share_only_a_database_and_a_bucket(
    tmp_path: Path, start_service: StartService, postgres: PostgresServer, s3: S3Server
) -> None:
    """As on several machines: no common folder. One is killed in the middle; the others do its work."""
    shared = {"database_url": postgres.new_database(), "storage_url": s3.new_storage(), "lease_s": 2}
    web = start_service("web", **shared, extra={**s3.environment, **FAKE_CODEC})
    workers = []
    for name in ("a", "b"):
        environment = {**web.environment, "SG_DATA_DIR": str(tmp_path / name)}
        with (tmp_path / f"{name}.log").open("w") as log:
            command = [sys.executable, "-m", "service", "worker"]
            workers.append(subprocess.Popen(command, cwd=ROOT, env=environment, stderr=log))
    jobs = [web.accepted_slow() for _ in range(3)]
    encoder = running_encoder(jobs[0])
    logs = [tmp_path / f"{name}.log" for name in ("a", "b")]
    wait_until(lambda: all("attempt 1" in log.read_text() for log in logs))
    (victim,) = filter(None, (worker_of(log, jobs[0]) for log in logs))
    os.kill(victim, signal.SIGKILL)
    wait_until(lambda: encoder not in processes())
    left = list(jobs)
    while left:  # in whatever order they come
        job_id, encoder = wait_until(lambda: [(job, number) for job in left if (number := encoder_of(job))])[0]
        end_early(encoder)
        assert web.wait(job_id)["state"] == "done"
        left.remove(job_id)
    for job_id in jobs:
        assert web.client.get(f"/decode/{job_id}.png").status_code == 200
    assert not (tmp_path / "a").exists()
    assert not (tmp_path / "b").exists()
    for worker in workers:
        worker.terminate()
        assert worker.wait(TIMEOUT_S) == (-signal.SIGKILL if worker.pid == victim else 0)


def test_supervisor_killed_alone(start_service: StartService) -> None:
    """Without their supervisor the other processes end by themselves, so that a new one finds free ground."""
    service = start_service(extra=FAKE_CODEC)
    encoder = running_encoder(service.accepted_slow())
    orphans = {encoder, *service.ours("sandbox"), *service.ours("web"), *service.ours("worker")}
    service.process.kill()
    service.process.wait()
    wait_until(lambda: not orphans & set(processes()))


def test_interrupt_stops_too(start_service: StartService) -> None:
    service = start_service()
    service.client.close()
    service.process.send_signal(signal.SIGINT)
    assert service.process.wait(TIMEOUT_S) == 0


def test_memory_limit(start_service: StartService) -> None:
    """An encode that wants more memory than it may have fails, and nothing else does."""
    service = start_service(job_memory_bytes=500 * 2**20, max_pixels=10**8)
    job = service.wait(service.accepted(saved(Image.new("RGB", (9000, 9000)))))
    assert (job["state"], job["attempt"], job["error"]["code"]) == ("failed", 1, "refused")
    assert "memory" in job["error"]["detail"]
    assert service.client.get("/livez").status_code == 200
