"""Confines a process that reads what strangers sent, before any of its code runs.

    python -m service.process.confinement MODULE ARGUMENTS...    runs a module as `python -m MODULE` does, confined

The system then refuses it every file but the code it runs and those in its own folder, TMPDIR (Landlock), other
processes, and whatever makes a connection or a program (seccomp): a picture that takes over its reader finds nothing to
take away. Its environment is what `environment` leaves of ours. limits of memory and time depend on the work; the
module sets them.

Both calls are made here, as no library that is kept up makes them. They stand before any import that starts threads,
since Landlock holds for the thread that asks for it, and for what that starts.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import resource
import runpy
import struct
import sys
import sysconfig
from collections.abc import Iterator, Mapping
from pathlib import Path

MODULE = "service.process.confinement"
# Where programs and libraries are looked for, languages, memory. Not what may be a secret.
KEPT_VARIABLES = ("PATH", "PYTHON", "VIRTUAL_ENV", "LANG", "LC_", "LD_", "MALLOC_", "GLIBC_TUNABLES")
MOST_FILES = 256  # open at once: the libraries of an encode take some 20
MOST_WRITTEN_BYTES = 1 << 24  # to one file

# include/uapi/linux/landlock.h
CREATE_RULESET, ADD_RULE, RESTRICT_SELF = 444, 445, 446  # system calls
ABI_VERSION, PATH_BENEATH = 1, 1
EXECUTE, READ_FILE, READ_DIR = 1 << 0, 1 << 2, 1 << 3
ALL_OF_FILES = {1: (1 << 13) - 1, 2: (1 << 14) - 1, 3: (1 << 15) - 1, 4: (1 << 15) - 1}  # by ABI; later ones add one
ALL_OF_NETWORK = 0b11  # since ABI 4: bind and connect of TCP
ALL_SCOPES = 0b11  # since ABI 6: abstract sockets and signals to processes outside

# include/uapi/linux/{prctl,seccomp,audit}.h and the table of system calls of x86-64
SET_NO_NEW_PRIVILEGES, SET_SECCOMP, FILTER = 38, 22, 2
X86_64, X32_BIT = 0xC000003E, 0x40000000
ALLOW, REFUSE = 0x7FFF0000, 0x00050000 | 1  # EPERM
REFUSED_CALLS = {
    **{"socket": 41, "connect": 42, "accept": 43, "bind": 49, "listen": 50, "accept4": 288},
    **{"execve": 59, "execveat": 322, "io_uring_setup": 425},
    **{"kill": 62, "tkill": 200, "ptrace": 101, "process_vm_readv": 310, "process_vm_writev": 311},
    **{"pidfd_getfd": 438, "pidfd_send_signal": 424, "unshare": 272, "mount": 165, "bpf": 321, "keyctl": 250},
    **{"perf_event_open": 298, "userfaultfd": 323},
}


def command(module: str, *arguments: str) -> list[str]:
    """The command line that runs a module confined."""
    return [sys.executable, "-m", MODULE, module, *arguments]


def environment(given: Mapping[str, str]) -> dict[str, str]:
    """What a confined process may know of an environment: nothing of the service's settings or keys."""
    return {name: value for name, value in given.items() if name.startswith(KEPT_VARIABLES)}


def confine() -> list[str]:
    """Confine this process and all that it starts; names what the system does not offer, such as "Landlock"."""
    missing = []
    resource.setrlimit(resource.RLIMIT_NOFILE, (MOST_FILES, MOST_FILES))
    resource.setrlimit(resource.RLIMIT_FSIZE, (MOST_WRITTEN_BYTES, MOST_WRITTEN_BYTES))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.prctl(SET_NO_NEW_PRIVILEGES, 1, 0, 0, 0) != 0:
        missing.append("no new privileges")
    if not _restrict_files(libc):
        missing.append("Landlock")
    if not _refuse_calls(libc):
        missing.append("seccomp")
    return missing


def _readable() -> Iterator[Path]:
    """Code and what it asks of the system: no data, and no other process."""
    yield Path(__file__).parents[1]  # the service
    for name in ("stdlib", "platstdlib", "purelib", "platlib"):
        yield Path(sysconfig.get_path(name))
    yield from (Path(entry) for entry in sys.path if Path(entry).name in ("site-packages", "dist-packages"))
    # Installed for editing, packages lie elsewhere.
    yield from (Path(entry) / name for entry in sys.path for name in ("sgmethod", "service") if entry)
    yield from (Path(base) / "bin" for base in (sys.prefix, sys.base_prefix))
    yield Path(sys.base_prefix, "lib")
    yield from map(Path, ("/usr/lib", "/usr/lib64", "/usr/share/zoneinfo", "/lib", "/lib64", "/etc/ld.so.cache"))
    yield from map(Path, ("/proc/self", "/proc/cpuinfo", "/proc/meminfo", "/sys/devices/system", "/sys/fs/cgroup"))
    yield from map(Path, ("/dev/null", "/dev/urandom"))


def _restrict_files(libc: ctypes.CDLL) -> bool:
    abi = libc.syscall(CREATE_RULESET, None, 0, ABI_VERSION)
    if abi < 1:
        return False
    handled = ALL_OF_FILES.get(abi, (1 << 16) - 1)
    network, scopes = (ALL_OF_NETWORK if abi >= 4 else 0), (ALL_SCOPES if abi >= 6 else 0)
    attributes = struct.pack("QQQ", handled, network, scopes)[: 8 if abi < 4 else 16 if abi < 6 else 24]
    ruleset = libc.syscall(CREATE_RULESET, attributes, len(attributes), 0)
    if ruleset < 0:
        return False
    try:
        for path in set(_readable()):
            with contextlib.suppress(OSError):
                _allow(libc, ruleset, path, READ_FILE | (READ_DIR if path.is_dir() else 0))
        if "TMPDIR" in os.environ:
            _allow(libc, ruleset, Path(os.environ["TMPDIR"]), handled & ~EXECUTE)
        return bool(libc.syscall(RESTRICT_SELF, ruleset, 0) == 0)
    finally:
        os.close(ruleset)


def _allow(libc: ctypes.CDLL, ruleset: int, path: Path, rights: int) -> None:
    """Raises OSError if there is no such path."""
    descriptor = os.open(path, os.O_PATH | os.O_CLOEXEC)
    try:
        libc.syscall(ADD_RULE, ruleset, PATH_BENEATH, struct.pack("=Qi", rights, descriptor), 0)
    finally:
        os.close(descriptor)


def _refuse_calls(libc: ctypes.CDLL) -> bool:
    """A filter in the kernel's own small language: load the call's number, compare, and so on."""
    load, equal, above, answer = 0x20, 0x15, 0x35, 0x06  # BPF_LD|W|ABS, BPF_JMP|JEQ, BPF_JMP|JGE, BPF_RET
    numbers = list(REFUSED_CALLS.values())
    end = len(numbers)
    steps = [
        (load, 0, 0, 4),  # the architecture
        (equal, 0, end + 3, X86_64),
        (load, 0, 0, 0),  # the number
        (above, end + 1, 0, X32_BIT),
        *((equal, end - place, 0, number) for place, number in enumerate(numbers)),
        (answer, 0, 0, ALLOW),
        (answer, 0, 0, REFUSE),
    ]
    code = ctypes.create_string_buffer(b"".join(struct.pack("HBBI", *step) for step in steps))
    program = struct.pack("HxxxxxxP", len(steps), ctypes.addressof(code))
    return bool(libc.prctl(SET_SECCOMP, FILTER, program, 0, 0) == 0)


def main() -> None:
    """Run the module that the command line names."""
    confine()
    del sys.argv[0]
    runpy.run_module(sys.argv[0], run_name="__main__", alter_sys=True)


if __name__ == "__main__":
    main()
