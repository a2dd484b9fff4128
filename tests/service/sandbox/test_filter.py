"""The filter of system calls, run step by step as the kernel runs it, for both architectures."""

from __future__ import annotations

import platform
import re
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest

from benchmarks.harness.processes import run
from service.sandbox.filter import (
    ABSENT,
    ALLOW,
    AND,
    ARCHITECTURES,
    EQUAL,
    LOAD,
    NUMBERS,
    REFUSE,
    RETURN,
    Step,
    program,
    steps,
)

PROCESS = 1234
HEADERS = {"x86_64": "x86_64-linux-gnu/asm/unistd_64.h", "aarch64": "asm-generic/unistd.h"}
MACHINES = list(ARCHITECTURES)
FORK = 0x11  # SIGCHLD, and nothing shared
# What a task that was taken over might want, by x86-64's and aarch64's numbers.
WANTED = {
    **{"open": (2, None), "openat": (257, 56), "openat2": (437, 437), "creat": (85, None), "newfstatat": (262, 79)},
    **{"unlinkat": (263, 35), "renameat2": (316, 276), "fchmodat": (268, 53), "utimensat": (280, 88)},
    **{"truncate": (76, 45), "linkat": (265, 37), "symlinkat": (266, 36), "mkdirat": (258, 34), "chdir": (80, 49)},
    **{"inotify_init1": (294, 26), "fanotify_init": (300, 262), "socket": (41, 198), "socketpair": (53, 199)},
    **{"connect": (42, 203), "sendmsg": (46, 211), "recvmsg": (47, 212), "fork": (57, None), "vfork": (58, None)},
    **{"execve": (59, 221), "execveat": (322, 281), "setsid": (112, 157), "setpgid": (109, 154), "kill": (62, 129)},
    **{"tkill": (200, 130), "rt_sigqueueinfo": (129, 138), "pidfd_open": (434, 434), "ptrace": (101, 117)},
    **{"pidfd_send_signal": (424, 424), "process_vm_readv": (310, 270), "process_vm_writev": (311, 271)},
    **{"sched_setaffinity": (203, 122), "sched_setscheduler": (144, 119), "setpriority": (141, 140)},
    **{"memfd_create": (319, 279), "shmget": (29, 194), "shmat": (30, 196), "msgget": (68, 186), "pipe2": (293, 59)},
    **{"mq_open": (240, 180), "io_uring_setup": (425, 425), "bpf": (321, 280), "perf_event_open": (298, 241)},
    **{"userfaultfd": (323, 282), "keyctl": (250, 219), "unshare": (272, 97), "setns": (308, 268)},
    **{"mount": (165, 40), "setuid": (105, 146), "seccomp": (317, 277), "setrlimit": (160, 164), "ioctl": (16, 29)},
}
PRIVATE, SHARED, VALIDATED, ANONYMOUS, GROWS_DOWN, HUGE = 0x2, 0x1, 0x3, 0x20, 0x100, 0x40000


def answer(machine: str, number: int, arguments: Sequence[int] = (), architecture: int | None = None) -> int:
    """What the kernel does about a call."""
    filled = [*arguments, *[0] * (6 - len(arguments))]
    words = [number, architecture or ARCHITECTURES[machine], 0, 0]
    words += [half for argument in filled for half in (argument & 0xFFFFFFFF, argument >> 32)]
    filter_steps: list[Step] = steps(machine, PROCESS)
    at = value = 0
    while True:
        code, if_true, if_false, constant = filter_steps[at]
        at += 1
        if code == LOAD:
            value = words[constant // 4]
        elif code == AND:
            value &= constant
        elif code == EQUAL:
            at += if_true if value == constant else if_false
        else:
            assert code == RETURN
            return constant


@pytest.mark.parametrize("machine", MACHINES)
@pytest.mark.parametrize("name", WANTED)
def test_what_is_refused(machine: str, name: str) -> None:
    number = WANTED[name][MACHINES.index(machine)]
    if number is not None:
        assert answer(machine, number) == REFUSE
        assert answer(machine, number, [2**64 - 1] * 6) == REFUSE


@pytest.mark.parametrize("machine", MACHINES)
@pytest.mark.parametrize(
    ("name", "arguments", "allowed"),
    [
        ("mmap", (0, 4096, 3, PRIVATE | ANONYMOUS), True),
        ("mmap", (0, 4096, 3, SHARED | ANONYMOUS), False),
        ("mmap", (0, 4096, 3, VALIDATED | ANONYMOUS), False),
        ("mmap", (0, 4096, 3, PRIVATE | ANONYMOUS | GROWS_DOWN), False),
        ("mmap", (0, 4096, 3, PRIVATE | ANONYMOUS | HUGE), False),
        ("mmap", (0, 4096, 3, PRIVATE | ANONYMOUS | 1 << 32), False),
        ("clone", (0x3D0F00,), True),
        ("clone", (0x7D0F00,), True),
        ("clone", (FORK,), False),
        ("clone", (0x3D0F00 & ~0x10000,), False),  # a process that shares everything
        ("clone", (0x3D0F00 | 0x10000000,), False),  # in a namespace of its own
        ("tgkill", (PROCESS, PROCESS, 6), True),
        ("tgkill", (PROCESS + 1, PROCESS, 6), False),
        ("tgkill", (PROCESS | 1 << 32, PROCESS, 6), False),
        ("prctl", (15,), True),
        ("prctl", (1,), False),
        ("sched_getaffinity", (0,), True),
        ("sched_getaffinity", (1,), False),
        ("prlimit64", (0, 7, 0, 1), True),
        ("prlimit64", (0, 7, 1, 0), False),
        ("prlimit64", (0, 7, 1 << 32, 0), False),
        ("prlimit64", (1, 7, 0, 1), False),
        ("read", (5,), True),
        ("exit_group", (0,), True),
    ],
)
def test_what_is_checked(machine: str, name: str, arguments: Sequence[int], allowed: bool) -> None:
    number = NUMBERS[name][MACHINES.index(machine)]
    assert number is not None
    assert answer(machine, number, arguments) == (ALLOW if allowed else REFUSE)


@pytest.mark.parametrize("machine", MACHINES)
def test_other_ways_to_name_a_call(machine: str) -> None:
    """As a program of 32 bits would, or of another architecture."""
    for numbers in NUMBERS.values():
        if (number := numbers[MACHINES.index(machine)]) is not None:
            assert answer(machine, number, architecture=0x40000003) == REFUSE
            assert answer(machine, number | 0x40000000) == REFUSE
    (other,) = set(ARCHITECTURES.values()) - {ARCHITECTURES[machine]}
    assert answer(machine, 0, architecture=other) == REFUSE
    # The C library tries clone3 first, whose flags no filter sees, and falls back if there is none.
    assert answer(machine, 435) == ABSENT


@pytest.mark.parametrize("machine", MACHINES)
def test_numbers_are_the_kernels(machine: str) -> None:
    header = Path("/usr/include", HEADERS[machine])
    if not header.exists():
        pytest.skip(f"needs {header}, of Debian's linux-libc-dev")
    found = re.findall(r"^#define __NR(?:3264)?_(\w+)\s+(\d+)$", header.read_text(), re.MULTILINE)
    known = {name: int(number) for name, number in found}
    known.setdefault("newfstatat", known.get("fstatat", 0))
    place = MACHINES.index(machine)
    for name, numbers in {**NUMBERS, **WANTED}.items():
        if numbers[place] is not None:
            assert known[name] == numbers[place], name


def test_the_kernel_takes_it() -> None:
    assert len(program("x86_64", PROCESS)) == 8 * len(steps("x86_64", PROCESS)) < 8 * 4096
    with pytest.raises(KeyError):
        program("riscv64", PROCESS)
    if platform.machine() in ARCHITECTURES:
        confined = "from service.sandbox.confinement import absent_layers; print(absent_layers())"
        output = run(sys.executable, "-c", confined)
        assert output.status == 0
        assert "seccomp" not in output.stdout
