"""The filter of system calls, run step by step as the kernel runs it, for both architectures."""

from __future__ import annotations

import platform
import re
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest

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
from tests.support.processes import run

PROCESS = 1234
HEADERS = {"x86_64": "x86_64-linux-gnu/asm/unistd_64.h", "aarch64": "asm-generic/unistd.h"}
MACHINES = list(ARCHITECTURES)
FORK = 0x11  # SIGCHLD, and nothing shared
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
def test_what_is_not_listed_is_refused(machine: str) -> None:
    listed = {numbers[MACHINES.index(machine)] for numbers in NUMBERS.values()}
    for number in set(range(600)) - listed:
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
    place = MACHINES.index(machine)
    for name, numbers in NUMBERS.items():
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
