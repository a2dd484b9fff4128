"""What a process can still do that reads a stranger's picture, when the picture has taken it over."""

from __future__ import annotations

import json
import os
import subprocess
from collections.abc import Sequence
from pathlib import Path

import pytest

from service.process import confinement
from tests.harness.data import ROOT
from tests.harness.processes import encoder_of, wait_until
from tests.harness.service import STAND_IN, StartService

SECRET = "not-for-strangers-" * 2
PROBE = """
import ctypes, json, os, signal, socket, subprocess
outcomes = []
for attempt in {attempts}:
    try:
        exec(attempt)
        outcomes.append("it went through")
    except OSError as error:
        outcomes.append(f"refused: {{error}}")
raise SystemExit(json.dumps(outcomes))
"""
ATTEMPTS = (
    "open('{secret}').read()",
    "os.listdir('{secret}/..')",
    "open('{secret}', 'w')",
    "open('{secret}/../new', 'w')",
    "os.unlink('{secret}')",
    "open('/etc/passwd').read()",
    "open(f'/proc/{parent}/environ').read()",
    "open(f'/proc/{parent}/mem', 'r+b')",
    "os.symlink('{secret}', os.environ['TMPDIR'] + '/way_out'); open(os.environ['TMPDIR'] + '/way_out').read()",
    "open(os.environ['TMPDIR'] + '/large', 'wb').write(bytes(1 << 25))",
    "socket.create_connection(('127.0.0.1', 9))",
    "socket.socket(socket.AF_INET, socket.SOCK_DGRAM)",
    "socket.socket(socket.AF_UNIX)",
    "subprocess.run(['/bin/true'])",
    "os.kill({parent}, signal.SIGTERM)",
    "os.kill({parent}, 0)",
    "os.dup2(0, 300)",
)


@pytest.fixture(scope="module", autouse=True)
def _kernel() -> None:
    """Where the system offers less, less is promised."""
    ask = "from service.process.confinement import confine; print(confine())"
    program = confinement.command("timeit", "-n1", "-r1", ask)
    said = subprocess.run(program, cwd=ROOT, capture_output=True, text=True, check=True)
    if not said.stdout.startswith("[]"):
        pytest.skip(f"this system does not offer {said.stdout.splitlines()[0]}")


def attempted(attempts: Sequence[str], folder: Path) -> list[str]:
    """How a confined process fares that tries one thing after the other, with a folder of its own."""
    program = confinement.command("timeit", "-n1", "-r1", PROBE.format(attempts=repr(attempts)))
    environment = {**confinement.environment(os.environ), "TMPDIR": str(folder)}
    said = subprocess.run(program, cwd=ROOT, env=environment, capture_output=True, text=True, check=False).stderr
    outcomes: list[str] = json.loads(said.splitlines()[-1].removeprefix("SystemExit: "))
    return outcomes


@pytest.fixture(scope="module")
def outcomes(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """The outcome of each of the ATTEMPTS."""
    folder = tmp_path_factory.mktemp("confined")
    secret, own = folder / "secret", folder / "own"
    secret.write_text(SECRET)
    own.mkdir()
    wishes = [a.replace("{secret}", str(secret)).replace("{parent}", str(os.getpid())) for a in ATTEMPTS]
    came = attempted(wishes, own)
    assert secret.read_text() == SECRET
    return dict(zip(ATTEMPTS, came, strict=True))


@pytest.mark.parametrize("attempt", ATTEMPTS)
def test_what_a_taken_over_process_tries(outcomes: dict[str, str], attempt: str) -> None:
    assert outcomes[attempt].startswith("refused: ")


def test_its_own_folder_is_its_own(tmp_path: Path) -> None:
    """What is refused above is refused by the confinement: the same attempts go through where they may."""
    assert attempted(["open(os.environ['TMPDIR'] + '/x', 'w').write('x')"], tmp_path) == ["it went through"]
    assert (tmp_path / "x").read_text() == "x"


def test_secrets_stay_behind() -> None:
    given = {
        "SG_LINK_SECRET": SECRET,
        "SG_API_KEYS": SECRET,
        "SG_DATABASE_URL": SECRET,
        "AWS_SECRET_ACCESS_KEY": SECRET,
        "PGPASSWORD": SECRET,
        "PATH": "/bin",
        "PYTHONPATH": "/opt",
    }
    assert confinement.environment(given) == {"PATH": "/bin", "PYTHONPATH": "/opt"}


def test_the_encoder_of_a_service_is_confined(tmp_path: Path, start_service: StartService) -> None:
    """Not only the launcher works: the service uses it."""
    service = start_service(link_secret=SECRET, extra={**STAND_IN, "TMPDIR": str(tmp_path)})
    job_id = service.accepted_slow()
    number = wait_until(lambda: encoder_of(job_id))
    process = Path("/proc", str(number))
    wait_until(lambda: "NoNewPrivs:\t1" in (status := (process / "status").read_text()) and "Seccomp:\t2" in status)
    assert SECRET.encode() not in (process / "environ").read_bytes()
    limits = (process / "limits").read_text()
    assert limits.count("unlimited  ") < (Path("/proc/self/limits")).read_text().count("unlimited  ")
    (folder,) = tmp_path.glob("sgmethod-*")
    service.client.delete(f"/jobs/{job_id}")
    wait_until(lambda: not folder.exists())
