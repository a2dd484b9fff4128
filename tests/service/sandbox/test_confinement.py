"""What a compromised task can still do."""

from __future__ import annotations

import os
import signal
from contextlib import ExitStack
from pathlib import Path

import pytest

from service.sandbox import confinement
from service.sandbox.confinement import LAYERS
from service.sandbox.frames import Crashed, Ended, TracePoint
from tests.service.sandbox_process import TAKEN_OVER, file_of, messages_of, sandbox, task
from tests.support.processes import encoder_of, failing, processes, running_encoder, wait_until
from tests.support.service import FAKE_CODEC, RunCommand, StartService

SECRET = "not-for-everyone-" * 2
MEMORY_BYTES = 2**28
PROBE = """
import ctypes, json, mmap, os, resource, signal, socket, sys
libc = ctypes.CDLL(None, use_errno=True)
secret, other = {secret!r}, {other}

def call(name, *arguments):
    if getattr(libc, name)(*arguments) < 0:
        raise OSError(ctypes.get_errno(), name)

for attempt in {attempts!r}:
    try:
        exec(attempt)
        say("it went through")
    except (OSError, ImportError, ValueError):
        say("refused")
"""
ATTEMPTS = (
    *("open(secret).read()", "os.listdir(os.path.dirname(secret))", "os.stat(secret)", "open(secret, 'w')"),
    *("open(secret + '.new', 'w')", "os.unlink(secret)", "os.rename(secret, secret + '.new')"),
    *("os.symlink(secret, '/tmp/way-out')", "os.mkdir('/tmp/way-out')", "os.chmod(secret, 0o777)"),
    *("os.utime(secret, (0, 0))", "os.truncate(secret, 0)", "os.chdir('/')", "open('/etc/passwd').read()"),
    *("open('/dev/shm/kept', 'w')", "open(f'/proc/{other}/environ').read()", "open('/proc/self/environ').read()"),
    *("open(f'/proc/{other}/mem', 'r+b')", "import smtplib"),
    *("call('inotify_init1', 0)", "call('fanotify_init', 0, 0)"),
    *("socket.socket(socket.AF_INET, socket.SOCK_DGRAM)", "socket.socket(socket.AF_UNIX)", "socket.socketpair()"),
    *("os.fork()", "call('vfork')", "os.execv('/bin/true', ['true'])", "os.posix_spawn('/bin/true', ['true'], {})"),
    *("os.setsid()", "os.setpgid(0, 0)", "call('unshare', 0x10000000)", "os.setuid(0)", "os.setresuid(0, 0, 0)"),
    *("os.kill(other, signal.SIGTERM)", "os.kill(other, 0)", "os.kill(os.getppid(), signal.SIGTERM)"),
    *("call('tgkill', other, other, 0)", "call('pidfd_open', other, 0)"),
    *("resource.prlimit(other, resource.RLIMIT_CPU, (1, 1))", "resource.prlimit(os.getppid(), resource.RLIMIT_CPU)"),
    "resource.setrlimit(resource.RLIMIT_DATA, (resource.RLIM_INFINITY,) * 2)",
    *("call('ptrace', 16, other, 0, 0)", "call('process_vm_readv', other, 0, 0, 0, 0, 0)"),
    *("os.sched_setaffinity(other, {0})", "os.sched_setscheduler(other, os.SCHED_IDLE, os.sched_param(0))"),
    "os.setpriority(os.PRIO_PROCESS, other, 19)",
    *("os.memfd_create('kept')", "call('shmget', 0, 4096, 0o1600)", "call('msgget', 0, 0o1600)", "mmap.mmap(-1, 4096)"),
    "mmap.mmap(-1, 4096, mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS | 0x100)",
    *("os.pipe()", "os.eventfd(0)", "os.dup(0)", "call('syscall', 425, 1, 0)", "call('syscall', 435, 0, 0)"),
    *("call('prctl', 1, 0, 0, 0, 0)", "signal.setitimer(signal.ITIMER_PROF, 0)"),
)
# What a system may lack, or what the service may run as.
NO_LANDLOCK, AS_ROOT = "confinement._refuse_files = lambda: False", "confinement._become_nobody = lambda: None"
SYSTEMS = {
    "whole": ("", ()),
    "without Landlock": (NO_LANDLOCK, LAYERS[:1]),
    "without Landlock, as root": (f"{NO_LANDLOCK}; {AS_ROOT}", (LAYERS[0], LAYERS[2])),
}


@pytest.fixture(scope="module", params=SYSTEMS)
def outcomes(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """The outcome of each of the ATTEMPTS."""
    secret = tmp_path_factory.mktemp("confined") / "secret"
    secret.write_text(SECRET)
    before = secret.stat()
    program = PROBE.format(secret=str(secret), other=os.getpid(), attempts=ATTEMPTS)
    preamble, absent = SYSTEMS[request.param]
    with sandbox(TAKEN_OVER + preamble, FAKE_CODEC, absent) as (tasks, _):
        *reports, end = messages_of(tasks, task(), program.encode())
    assert end == Ended(status=0)
    assert secret.read_text() == SECRET
    assert (secret.stat().st_mode, secret.stat().st_mtime) == (before.st_mode, before.st_mtime)
    assert not Path("/tmp/way-out").exists()
    return dict(zip(ATTEMPTS, (report.phase for report in reports), strict=True))


@pytest.mark.parametrize("attempt", ATTEMPTS)
def test_what_a_taken_over_task_tries(outcomes: dict[str, str], attempt: str) -> None:
    assert outcomes[attempt] == "refused"


def test_a_task_with_fewer_layers_than_the_system_is_refused() -> None:
    """The sandbox probed again when it started: if that failed once, as without memory, all tasks went on without."""
    with sandbox(TAKEN_OVER + NO_LANDLOCK, FAKE_CODEC) as (tasks, _):
        (report,) = messages_of(tasks, task(), b"say('it ran')")
    assert isinstance(report, Crashed)
    assert "not confined by Landlock" in report.detail


HOARD = """
import ctypes, mmap, time
libc = ctypes.CDLL(None, use_errno=True)
libc.mmap.restype = libc.malloc.restype = libc.mremap.restype = ctypes.c_void_p
libc.mremap.argtypes = [ctypes.c_void_p, ctypes.c_size_t, ctypes.c_size_t, ctypes.c_int]
libc.memset.argtypes = [ctypes.c_void_p, ctypes.c_int, ctypes.c_size_t]
PART, FAILED, kept = 1 << 24, 2**64 - 1, []

def mapped(protection, flags):
    place = libc.mmap(None, PART, protection, flags, -1, 0)
    return None if place == FAILED else place

def opened():  # counted as memory only when it is made writable
    place = mapped(1, 0x22)
    return place if place and libc.mprotect(ctypes.c_void_p(place), PART, 3) == 0 else None

def grown():
    place = libc.mmap(None, 4096, 3, 0x22, -1, 0)
    place = FAILED if place == FAILED else libc.mremap(place, 4096, PART, 1)
    return None if place == FAILED else place

kinds = [lambda: mapped(3, 0x22), lambda: mapped(3, 0x21), lambda: mapped(3, 0x122), lambda: libc.malloc(PART), opened]
for kind in (*kinds, grown):
    for _ in range(100):
        place = kind()
        if not place:
            break
        libc.memset(place, 1, PART)
try:
    while True:
        kept.append(bytes(PART))
except MemoryError:
    pass
say("holds it")
time.sleep(1000)
"""


@pytest.mark.parametrize("system", SYSTEMS)
def test_memory_of_every_kind_is_limited(system: str) -> None:
    """Beyond what the codec takes, which forks share."""
    greedy = task(memory_bytes=MEMORY_BYTES)
    with (
        sandbox(TAKEN_OVER + SYSTEMS[system][0], FAKE_CODEC, SYSTEMS[system][1]) as (tasks, _),
        file_of(HOARD.encode()) as file,
        tasks.start(greedy, file) as running,
    ):
        wait_until(lambda: any(isinstance(message, TracePoint) for message in running.read(1.0)))
        rollup = Path(f"/proc/{encoder_of(greedy.job_id)}/smaps_rollup").read_text().splitlines()
        held = 1024 * sum(int(line.split()[1]) for line in rollup if line.startswith(("Private_Dirty", "Shared_Dirty")))
        assert 0.9 * MEMORY_BYTES < held < MEMORY_BYTES + 2**27


@pytest.mark.parametrize("system", [name for name in SYSTEMS if "root" not in name])
def test_threads_are_limited(system: str) -> None:
    """Of each task by itself, whatever others of the same user have; root has no limit."""
    program = """
import threading, time
threading.stack_size(32768)
started = 0
try:
    while started < 1000:
        threading.Thread(target=time.sleep, args=(1000,), daemon=True).start()
        started += 1
except RuntimeError:
    pass
say(str(started))
time.sleep(1000)
"""
    preamble, absent = SYSTEMS[system]
    with sandbox(f"{TAKEN_OVER}import threading\n{preamble}", FAKE_CODEC, absent) as (tasks, _), ExitStack() as held:

        def is_limited(threads: int) -> bool:
            file, what = held.enter_context(file_of(program.encode())), task(threads=threads)
            running = held.enter_context(tasks.start(what, file))
            report = wait_until(lambda: [m for m in running.read(0.1) if isinstance(m, TracePoint)])
            return what.max_threads - 2 <= int(report[0].phase) <= what.max_threads + confinement.THREADS_STEP

        # Threads of others come and go as they are counted, sometimes many at once: then it is tried again.
        for threads in (1, 10, 1):
            wait_until(lambda threads=threads: is_limited(threads))


def test_time_is_limited() -> None:
    """Also of one that does not listen to the timer."""
    program = b"import signal\nsignal.signal(signal.SIGPROF, signal.SIG_IGN)\nwhile True: pass"
    with sandbox(TAKEN_OVER, FAKE_CODEC) as (tasks, _):
        assert messages_of(tasks, task(cpu_s=0.1), b"while True: pass")[-1] == Ended(status=-signal.SIGPROF)
        assert messages_of(tasks, task(cpu_s=0.1), program)[-1] == Ended(status=-signal.SIGKILL)


def test_tasks_see_nothing_of_each_other() -> None:
    """Neither their descriptors, nor what another has left in memory."""
    look = b"import sys; say(repr(hasattr(sys, 'left_behind')))"
    sleeps = b"import sys, time; sys.left_behind = 1; say('sleeps'); time.sleep(1000)"
    sleeper = task()
    with sandbox(TAKEN_OVER, FAKE_CODEC) as (tasks, _), file_of(sleeps) as file, tasks.start(sleeper, file) as running:
        wait_until(lambda: running.read(0.1))  # a task that has only begun has not closed its file yet
        report, _ = messages_of(tasks, task(), look)
        assert report.phase == "False"
        descriptors = Path(f"/proc/{encoder_of(sleeper.job_id)}/fd")
        opened = [str(entry.readlink()).partition(":")[0] for entry in descriptors.iterdir()]
        assert sorted(opened) == ["/dev/null"] * 3 + ["socket"] * 2  # to its client, and to the sandbox


def test_secrets_stay_behind() -> None:
    secrets = ("SG_LINK_SECRET", "SG_API_KEYS", "SG_DATABASE_URL", "AWS_SECRET_ACCESS_KEY", "PGPASSWORD")
    known = {"PATH": "/bin", "PYTHONPATH": "/opt", "OPENBLAS_CORETYPE": "Haswell"}
    assert confinement.environment(dict.fromkeys(secrets, SECRET) | known) == known


def test_the_encoder_of_a_service_is_confined(start_service: StartService) -> None:
    service = start_service(link_secret=SECRET, extra=FAKE_CODEC)
    job_id = service.accepted_slow()
    number = running_encoder(job_id)
    process = Path("/proc", str(number))
    wait_until(lambda: "NoNewPrivs:\t1" in (status := (process / "status").read_text()) and "Seccomp:\t2" in status)
    assert os.geteuid() != 0 or f"Uid:\t{confinement.NOBODY}\t{confinement.NOBODY}" in (process / "status").read_text()
    assert SECRET.encode() not in (process / "environ").read_bytes()
    service.client.delete(f"/jobs/{job_id}")
    wait_until(lambda: number not in processes())


@pytest.mark.parametrize("command", ["serve", "web", "worker"])
def test_a_sandbox_that_is_required(
    run_command: RunCommand, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: str
) -> None:
    monkeypatch.setattr("service.commands.absent_layers", lambda: ["Landlock"])
    result = run_command(command, data_dir=tmp_path, port=0, require_sandbox=1)
    assert result.status == 1
    assert "cannot start: SG_REQUIRE_SANDBOX is set, and this system does not offer Landlock" in result.stderr
    monkeypatch.setattr("service.checking.absent_layers", lambda: ["Landlock", "seccomp"])
    missing = "Landlock and seccomp"
    result = run_command("check", data_dir=tmp_path, require_sandbox=1)
    assert f"FAILED  sandbox: SG_REQUIRE_SANDBOX is set, and this system does not offer {missing}" in result.stdout
    result = run_command("check", data_dir=tmp_path)
    assert f"ok      sandbox: uploads are read without {missing}, which this system does not offer" in result.stdout


def test_missing_layers_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(confinement, "_refuse_files", lambda: False)
    monkeypatch.setattr(confinement, "_become_nobody", lambda: False)
    monkeypatch.setattr(os, "geteuid", lambda: 0)
    absent, root = confinement.check_layers(confinement.absent_layers(), required=False)
    missing = "Landlock and a user other than root"
    assert absent == f"uploads are read without {missing}, which this system does not offer"
    assert "runs as root" in root


def test_a_system_that_cannot_confine(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(confinement, "confine", failing(confinement.confine, OSError("not here")))
    with pytest.raises(confinement.SandboxError, match="cannot be confined"):
        confinement.absent_layers()
