"""The system calls that a task may make, as a filter in the kernel's own small language (seccomp, classic BPF).

A call that is not listed is refused: opening, naming or changing files, making processes, sockets and shared memory,
and whatever concerns other processes. A task needs none of these, because its file is in memory and the codec is
imported. If an argument selects one of several operations of a call, the filter checks the argument too.

Both architectures are little-endian, and pass all these arguments in the same order.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

# include/uapi/linux/audit.h
X86_64, AARCH64 = 0xC000003E, 0xC00000B7
ARCHITECTURES = {"x86_64": X86_64, "aarch64": AARCH64}

# Numbers of calls on x86-64 and aarch64: arch/x86/entry/syscalls/syscall_64.tbl, include/uapi/asm-generic/unistd.h.
NUMBERS: dict[str, tuple[int | None, int | None]] = {
    **{"read": (0, 63), "write": (1, 64), "writev": (20, 66), "close": (3, 57), "poll": (7, None), "ppoll": (271, 73)},
    **{"mmap": (9, 222), "munmap": (11, 215), "mremap": (25, 216), "mprotect": (10, 226), "madvise": (28, 233)},
    **{"brk": (12, 214), "futex": (202, 98), "sched_yield": (24, 124), "set_robust_list": (273, 99)},
    **{"rseq": (334, 293), "clone": (56, 220), "clone3": (435, 435), "exit": (60, 93), "exit_group": (231, 94)},
    **{"getpid": (39, 172), "gettid": (186, 178), "tgkill": (234, 131), "prctl": (157, 167)},
    **{"rt_sigaction": (13, 134), "rt_sigprocmask": (14, 135), "rt_sigreturn": (15, 139), "sigaltstack": (131, 132)},
    **{"restart_syscall": (219, 128), "getrandom": (318, 278), "getcpu": (309, 168), "sysinfo": (99, 179)},
    **{"sched_getaffinity": (204, 123), "prlimit64": (302, 261), "getrusage": (98, 165), "times": (100, 153)},
    **{"clock_gettime": (228, 113), "clock_getres": (229, 114), "gettimeofday": (96, 169), "time": (201, None)},
    **{"clock_nanosleep": (230, 115), "nanosleep": (35, 101), "select": (23, None), "pselect6": (270, 72)},
}

MAP_TYPE, MAP_PRIVATE, MAP_GROWSDOWN, MAP_HUGETLB = 0xF, 0x2, 0x100, 0x40000
# What glibc and musl give to a new thread: VM, FS, FILES, SIGHAND, THREAD, SYSVSEM, SETTLS, PARENT_SETTID,
# CHILD_CLEARTID; musl adds DETACHED, which is obsolete.
THREAD, DETACHED = 0x3D0F00, 0x400000
SET_NAME = 15  # of prctl
WHOLE = 0xFFFFFFFF

# include/uapi/linux/{seccomp,bpf_common}.h
ALLOW, REFUSE, ABSENT = 0x7FFF0000, 0x00050000 | 1, 0x00050000 | 38  # EPERM, ENOSYS
LOAD, EQUAL, AND, RETURN = 0x20, 0x15, 0x54, 0x06  # LD|W|ABS, JMP|JEQ|K, ALU|AND|K, RET|K
CALL_AT, ARCHITECTURE_AT, ARGUMENTS_AT = 0, 4, 16  # in struct seccomp_data


@dataclass(frozen=True)
class Check:
    """A test of a 64-bit argument: its masked lower half equals a value, and its upper half is zero."""

    argument: int
    value: int
    mask: int = WHOLE


def _checks(process: int) -> dict[str, list[Check]]:
    return {
        # No memory that its limit does not count: shared, of huge pages, or growing as stacks do.
        "mmap": [Check(3, MAP_PRIVATE, MAP_TYPE | MAP_GROWSDOWN | MAP_HUGETLB)],
        "clone": [Check(0, THREAD, WHOLE & ~DETACHED)],
        "tgkill": [Check(0, process)],
        "prctl": [Check(0, SET_NAME)],
        "sched_getaffinity": [Check(0, 0)],
        "prlimit64": [Check(0, 0), Check(2, 0)],  # of this process, and only to read
    }


Step = tuple[int, int, int, int]  # code, steps to skip if true, steps to skip if false, constant


def steps(machine: str, process: int) -> list[Step]:
    """Return the filter for a process number and a machine, as platform.machine() names it. Raises KeyError."""
    architecture = ARCHITECTURES[machine]
    place = list(ARCHITECTURES).index(machine)
    checks = _checks(process)
    program: list[Step] = [
        (LOAD, 0, 0, ARCHITECTURE_AT),
        (EQUAL, 1, 0, architecture),
        (RETURN, 0, 0, REFUSE),
        (LOAD, 0, 0, CALL_AT),
    ]
    for name, numbers in NUMBERS.items():
        number = numbers[place]
        if number is not None:
            # The C library falls back to clone, whose flags this filter can check.
            answer = ABSENT if name == "clone3" else ALLOW
            block = [*(step for check in checks.get(name, ()) for step in _checked(check)), (RETURN, 0, 0, answer)]
            program += [(EQUAL, 0, len(block), number), *block]
    return [*program, (RETURN, 0, 0, REFUSE)]


def _checked(check: Check) -> list[Step]:
    low = ARGUMENTS_AT + 8 * check.argument
    return [
        (LOAD, 0, 0, low),
        (AND, 0, 0, check.mask),
        (EQUAL, 1, 0, check.value),
        (RETURN, 0, 0, REFUSE),
        (LOAD, 0, 0, low + 4),
        (EQUAL, 1, 0, 0),
        (RETURN, 0, 0, REFUSE),
    ]


def program(machine: str, process: int) -> bytes:
    """Return the filter as the kernel reads it. Raises KeyError for a machine of another architecture."""
    return b"".join(struct.pack("=HBBI", *step) for step in steps(machine, process))
