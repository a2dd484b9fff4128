"""Confine a process that is about to read an upload.

The layers, each of which works without the others:

    seccomp     only the system calls of filter.py
    Landlock    no file, no connection, no signal to another process
    limits      memory, time, files, threads
    nobody      where the service runs as root, tasks run as this user

Before that, a task has its file in memory, its descriptors closed and an environment without secrets. Two system calls
are made directly, because no maintained library wraps them.
"""

from __future__ import annotations

import contextlib
import ctypes
import math
import os
import platform
import resource
import signal
import struct
import threading
from collections.abc import Collection, Mapping
from pathlib import Path

from service.sandbox import filter as calls

# Paths of programs and libraries, languages, memory, and kernels, on which the last digit of a fit depends. Any other
# variable may be a secret.
VISIBLE_VARIABLES = (
    *("PATH", "PYTHON", "VIRTUAL_ENV", "LANG", "LC_", "LD_", "MALLOC_", "GLIBC_TUNABLES"),
    *("OPENBLAS_", "SG_ISA"),
)
LAYERS = ("Landlock", "seccomp", "a user other than root")  # the layers that a system may lack
NOBODY = 65_534
LEEWAY_BYTES = 2 << 30  # of address space: libraries, stacks and arenas reserve more than they use
PROBE_BYTES = 16 << 20  # for the fork of absent_layers()
OOM_SCORE = "500"  # of -1000 to 1000; the service has 0 unless told otherwise
MAX_USER_THREADS, THREADS_STEP = 8192, 16  # all threads of the user; precision of the count
NOTHING = (
    *(resource.RLIMIT_NOFILE, resource.RLIMIT_FSIZE, resource.RLIMIT_CORE),
    *(resource.RLIMIT_MEMLOCK, resource.RLIMIT_MSGQUEUE),
)

# include/uapi/linux/landlock.h
CREATE_RULESET, RESTRICT_SELF, ABI_VERSION = 444, 446, 1
ALL_OF_FILES = {1: (1 << 13) - 1, 2: (1 << 14) - 1, 3: (1 << 15) - 1, 4: (1 << 15) - 1}  # by ABI; later ones add one
ALL_OF_NETWORK = 0b11  # since ABI 4: bind and connect of TCP
ALL_SCOPES = 0b11  # since ABI 6: abstract sockets and signals to processes outside

# include/uapi/linux/{prctl,seccomp}.h
SET_PARENT_DEATH_SIGNAL, SET_NO_NEW_PRIVILEGES = 1, 38
SECCOMP_CALLS = {"x86_64": 317, "aarch64": 277}
SET_FILTER, ALL_THREADS = 1, 1

_libc = ctypes.CDLL(None, use_errno=True)  # opened here: a fork that is confined opens nothing


def environment(given: Mapping[str, str]) -> dict[str, str]:
    """Return the variables that a confined process may see: none of the service's settings or keys."""
    return {name: value for name, value in given.items() if name.startswith(VISIBLE_VARIABLES)}


def set_name(name: str) -> None:
    """Set the name of this process in process lists, which show its first 15 bytes."""
    _libc.prctl(calls.SET_NAME, name.encode(), 0, 0, 0)


def die_first() -> None:
    """Have the system end this process before those of the service if memory runs out."""
    with contextlib.suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text(OOM_SCORE)


def end_with(parent: int, number: int = signal.SIGKILL) -> None:
    """Have the system send this process a signal when its parent ends, for whatever reason."""
    _libc.prctl(SET_PARENT_DEATH_SIGNAL, number, 0, 0, 0)
    if os.getppid() != parent:  # it ended before the call above
        os.kill(os.getpid(), number)


def confine(memory_bytes: int, cpu_s: float, threads: int, parent: int) -> list[str]:
    """Confine this process irreversibly. Returns the LAYERS that the system lacks.

    memory_bytes: beyond its present size; cpu_s: seconds of a core until SIGPROF ends it; threads: that it may start,
    give or take THREADS_STEP; parent: process that it ends with.
    """
    is_other = os.geteuid() != 0 or _become_nobody()
    max_threads = _threads_of_user() + threads
    pages = Path("/proc/self/statm").read_text().split()
    size, data = (int(pages[place]) * resource.getpagesize() for place in (0, 5))
    _libc.prctl(SET_NO_NEW_PRIVILEGES, 1, 0, 0, 0)
    landlock = _refuse_files()
    _limit(
        {
            resource.RLIMIT_DATA: data + memory_bytes,
            resource.RLIMIT_AS: size + memory_bytes + LEEWAY_BYTES,  # memory of every kind
            resource.RLIMIT_CPU: math.ceil(cpu_s) + 1,  # for a task that blocks the timer's signal
            resource.RLIMIT_NPROC: max_threads,  # else one task could use up the user's threads
            **dict.fromkeys(NOTHING, 0),
        }
    )
    signal.setitimer(signal.ITIMER_PROF, cpu_s)
    end_with(parent)  # again: changing the user undid it
    seccomp = _refuse_calls()  # last: it forbids the calls above
    return [name for name, holds in zip(LAYERS, (landlock, seccomp, is_other), strict=True) if not holds]


def absent_layers() -> list[str]:
    """Return the layers that this system lacks, tried in a fork. Call it while this process has a single thread.

    Raises SandboxError if the fork cannot be confined at all.
    """
    read_end, write_end = os.pipe()
    parent = os.getpid()
    child = os.fork()
    if child == 0:
        try:
            os.write(write_end, ", ".join(confine(PROBE_BYTES, 1.0, 0, parent)).encode())
            os._exit(0)
        finally:
            os._exit(1)
    os.close(write_end)
    with os.fdopen(read_end) as pipe:
        absent = pipe.read()
    _, status = os.waitpid(child, 0)
    if status:
        raise SandboxError("processes that read uploads cannot be confined on this system")
    return list(filter(None, absent.split(", ")))


class SandboxError(Exception):
    """The sandbox cannot be set up, or lacks a required layer; one sentence."""


def check_layers(layers: Collection[str], *, required: bool) -> list[str]:
    """Return warnings about absent layers and about root. Raises SandboxError if layers are absent and required."""
    absent = " and ".join(layers)
    if absent and required:
        raise SandboxError(f"SG_REQUIRE_SANDBOX is set, and this system does not offer {absent}")
    missing = [f"uploads are read without {absent}, which this system does not offer"] if absent else []
    root = "the service runs as root" + "; the processes that read uploads run as nobody" * (LAYERS[-1] not in layers)
    return missing + [root] * (os.geteuid() == 0)


def _threads_of_user() -> int:
    """Return the number of threads of this process's user, or up to THREADS_STEP more.

    The system limits threads by user, not by process, and reveals their number only by refusing the next one.
    """
    _, hard = resource.getrlimit(resource.RLIMIT_NPROC)
    end = MAX_USER_THREADS if hard == resource.RLIM_INFINITY else min(hard, MAX_USER_THREADS)
    for limit in range(THREADS_STEP, end, THREADS_STEP):
        resource.setrlimit(resource.RLIMIT_NPROC, (limit, hard))
        one_more = threading.Thread(target=int)
        try:
            one_more.start()
        except RuntimeError:
            continue
        one_more.join()
        return limit
    return end


def _limit(limits: Mapping[int, int]) -> None:
    for what, limit in limits.items():
        _, hard = resource.getrlimit(what)
        allowed = limit if hard == resource.RLIM_INFINITY else min(limit, hard)
        resource.setrlimit(what, (allowed, allowed))


def _become_nobody() -> bool:
    try:
        os.setgroups([])
        os.setresgid(NOBODY, NOBODY, NOBODY)
        os.setresuid(NOBODY, NOBODY, NOBODY)
    except OSError:  # as in a container without this user
        return False
    return True


def _refuse_files() -> bool:
    abi = _libc.syscall(CREATE_RULESET, None, 0, ABI_VERSION)
    if abi < 1:
        return False
    files = ALL_OF_FILES.get(abi, (1 << 16) - 1)
    network, scopes = (ALL_OF_NETWORK if abi >= 4 else 0), (ALL_SCOPES if abi >= 6 else 0)
    attributes = struct.pack("QQQ", files, network, scopes)[: 8 if abi < 4 else 16 if abi < 6 else 24]
    ruleset = _libc.syscall(CREATE_RULESET, attributes, len(attributes), 0)
    if ruleset < 0:
        return False
    try:
        return bool(_libc.syscall(RESTRICT_SELF, ruleset, 0) == 0)
    finally:
        os.close(ruleset)


def _refuse_calls() -> bool:
    machine = platform.machine()
    if machine not in SECCOMP_CALLS:
        return False
    code = ctypes.create_string_buffer(calls.program(machine, os.getpid()))
    program = struct.pack("HxxxxxxP", len(code.raw) // 8, ctypes.addressof(code))
    return bool(_libc.syscall(SECCOMP_CALLS[machine], SET_FILTER, ALL_THREADS, program) == 0)
