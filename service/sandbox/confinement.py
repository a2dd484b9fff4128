"""Confines a process that is about to read what a stranger sent.

Its layers, each of which holds without the others as far as it reaches:

    seccomp     only the system calls of filter.py
    Landlock    no file, no connection, no signal to another process
    limits      memory, time, files, threads
    nobody      where the service runs as root, tasks do not

Before that, a task has its file in memory, its descriptors closed and an environment without secrets. Two calls are
made here, as no library that is kept up makes them.
"""

from __future__ import annotations

import ctypes
import math
import os
import platform
import resource
import signal
import struct
from collections.abc import Mapping
from pathlib import Path

from service.sandbox import filter as calls

# Where programs and libraries are looked for, languages, memory, and the kernels of OpenBLAS, on which the last digit
# of a fit depends. Not what may be a secret.
KEPT_VARIABLES = ("PATH", "PYTHON", "VIRTUAL_ENV", "LANG", "LC_", "LD_", "MALLOC_", "GLIBC_TUNABLES", "OPENBLAS_")
LAYERS = ("Landlock", "seccomp", "a user other than root")  # which a system may lack
NOBODY = 65_534
LEEWAY_BYTES = 2 << 30  # of addresses: libraries, stacks and arenas of threads reserve more than they use
PROBE_BYTES = 16 << 20  # for one that only confines itself
MOST_THREADS = 8192  # of the user: a bomb of threads would take memory of the system's own
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
    """What a confined process may know of an environment: nothing of the service's settings or keys."""
    return {name: value for name, value in given.items() if name.startswith(KEPT_VARIABLES)}


def set_name(name: str) -> None:
    """What this process is called in lists of processes, which show the beginning of it."""
    _libc.prctl(calls.SET_NAME, name.encode(), 0, 0, 0)


def end_with(parent: int, number: int = signal.SIGKILL) -> None:
    """Let the system send this process the signal when its parent has ended, however that ended."""
    _libc.prctl(SET_PARENT_DEATH_SIGNAL, number, 0, 0, 0)
    if os.getppid() != parent:  # it has ended just before
        os.kill(os.getpid(), number)


def confine(memory_bytes: int, cpu_s: float, parent: int) -> list[str]:
    """Confine this process, for good; returns the LAYERS that the system does not offer.

    memory_bytes: more than it has; cpu_s: seconds of a core until it ends by SIGPROF; parent: with which it ends.
    """
    pages = Path("/proc/self/statm").read_text().split()
    size, data = (int(pages[place]) * resource.getpagesize() for place in (0, 5))
    _libc.prctl(SET_NO_NEW_PRIVILEGES, 1, 0, 0, 0)
    landlock = _refuse_files()
    _limit(
        {
            resource.RLIMIT_DATA: data + memory_bytes,
            resource.RLIMIT_AS: size + memory_bytes + LEEWAY_BYTES,  # whatever kind of memory it is
            resource.RLIMIT_CPU: math.ceil(cpu_s) + 1,  # for one that does not listen to the timer
            resource.RLIMIT_NPROC: MOST_THREADS,
            **dict.fromkeys(NOTHING, 0),
        }
    )
    signal.setitimer(signal.ITIMER_PROF, cpu_s)
    is_other = os.geteuid() != 0 or _become_nobody()
    end_with(parent)  # which a change of user takes back
    seccomp = _refuse_calls()  # last, as it allows none of the above
    return [name for name, holds in zip(LAYERS, (landlock, seccomp, is_other), strict=True) if not holds]


def absent_layers() -> list[str]:
    """The layers that this system does not offer, found out by a fork of this process, which has one thread still.

    Raises SandboxError if it cannot be confined at all.
    """
    told, tell = os.pipe()
    parent = os.getpid()
    child = os.fork()
    if child == 0:
        try:
            os.write(tell, ", ".join(confine(PROBE_BYTES, 1.0, parent)).encode())
            os._exit(0)
        finally:
            os._exit(1)
    os.close(tell)
    with os.fdopen(told) as pipe:
        absent = pipe.read()
    _, status = os.waitpid(child, 0)
    if status:
        raise SandboxError("what reads uploads cannot be confined on this system")
    return list(filter(None, absent.split(", ")))


class SandboxError(Exception):
    """The sandbox cannot be set up, or lacks a layer that must not be missing; one sentence."""


def check_layers(*, required: bool) -> list[str]:
    """Sentences on what the system does not offer, and on root. Raises SandboxError if a layer that is required is
    missing.
    """
    layers = absent_layers()
    absent = " and ".join(layers)
    if absent and required:
        raise SandboxError(f"SG_REQUIRE_SANDBOX is set, and this system does not offer {absent}")
    missing = [f"uploads are read without {absent}, which this system does not offer"] if absent else []
    root = "the service runs as root" + "; what reads uploads runs as nobody" * (LAYERS[-1] not in layers)
    return missing + [root] * (os.geteuid() == 0)


def _limit(limits: Mapping[int, int]) -> None:
    for what, limit in limits.items():
        _, hard = resource.getrlimit(what)
        most = limit if hard == resource.RLIM_INFINITY else min(limit, hard)
        resource.setrlimit(what, (most, most))


def _become_nobody() -> bool:
    try:
        os.setgroups([])
        os.setresgid(NOBODY, NOBODY, NOBODY)
        os.setresuid(NOBODY, NOBODY, NOBODY)
    except OSError:  # as in a container that knows no such user
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
