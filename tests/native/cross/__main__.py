"""Compiles the core for other machines and runs what can be run: python -m tests.native.cross [NAME ...].

Each target is one line: what was compiled, and whether the core's tests passed, one of which draws a golden file. GCC,
Clang, qemu and Wine are Debian's; zig (PyPI's ziglang) brings the C and C++ libraries of the other systems. What cannot
be run is compiled as a library, and not linked.
"""

from __future__ import annotations

import argparse
import importlib.util
import os
import shlex
import shutil
import stat
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

from tests.native.harness.build import BUILDS, PATH, build

TOOLS = BUILDS / "cross" / "tools"
ARM = "qemu-aarch64-static"
WINE = "/usr/lib/wine/wine64"  # where Debian's package wine64 has it


@dataclass(frozen=True)
class Target:
    """A machine, and how its programs are made and run.

    compiler: its command, "zig" standing for zig's; system, processor: as CMake names them; runner: the command
    before a program, None where it cannot be run here; static: whether the program brings its libraries.
    """

    name: str
    compiler: str
    system: str = "Linux"
    processor: str = "x86_64"
    runner: str | None = ""
    static: bool = False


TARGETS = [
    Target("linux-x86_64-gcc", "g++"),
    Target("linux-x86_64-clang", "clang++"),
    Target("linux-x86_64-musl", "zig -target x86_64-linux-musl", static=True),
    Target("linux-aarch64-gcc", "aarch64-linux-gnu-g++", processor="aarch64", runner=ARM, static=True),
    Target("linux-aarch64-clang", "clang++ --target=aarch64-linux-gnu", processor="aarch64", runner=ARM, static=True),
    Target("linux-aarch64-musl", "zig -target aarch64-linux-musl", processor="aarch64", runner=ARM, static=True),
    # Without vectors of its own, so with what the compiler makes of ours.
    Target(
        "linux-riscv64-musl", "zig -target riscv64-linux-musl", "Linux", "riscv64", "qemu-riscv64-static", static=True
    ),
    Target("windows-x86_64", "zig -target x86_64-windows-gnu", "Windows", runner=WINE),
    Target("windows-aarch64", "zig -target aarch64-windows-gnu", "Windows", "aarch64", runner=None),
    Target("macos-aarch64", "zig -target aarch64-macos", "Darwin", "aarch64", runner=None),
    Target("macos-x86_64", "zig -target x86_64-macos", "Darwin", runner=None),
]


def zig() -> Path | None:
    """Where zig lies."""
    found = importlib.util.find_spec("ziglang")
    return Path(found.submodule_search_locations[0]) / "zig" if found and found.submodule_search_locations else None


def script(name: str, command: str) -> str:
    """A program that runs a command with its arguments: CMake wants one name for a tool."""
    TOOLS.mkdir(parents=True, exist_ok=True)
    path = TOOLS / name
    path.write_text(f'#!/bin/sh\nexec {command} "$@"\n')
    path.chmod(path.stat().st_mode | stat.S_IXUSR)
    return str(path)


def missing(target: Target) -> str:
    """What is needed and not there, or nothing."""
    compiler, *options = target.compiler.split()
    if compiler == "zig":
        return "" if zig() else "zig (pip install ziglang)"
    if not shutil.which(compiler, path=PATH):
        return f"{compiler}"
    if any(option.startswith("--target") for option in options) and not Path("/usr/aarch64-linux-gnu").exists():
        return "g++-aarch64-linux-gnu, whose libraries Clang takes"
    return ""


def made(target: Target) -> Path:
    """The folder of a target's programs. Raises CalledProcessError."""
    compiler, *options = target.compiler.split()
    settings = [f"-DCMAKE_SYSTEM_NAME={target.system}", f"-DCMAKE_SYSTEM_PROCESSOR={target.processor}"]
    if target.runner is None:  # zig would build the system's libraries to link anything
        settings += ["-DSG_TESTS=OFF", "-DCMAKE_TRY_COMPILE_TARGET_TYPE=STATIC_LIBRARY"]
        options.append("-c")
    if target.static:
        settings.append("-DCMAKE_EXE_LINKER_FLAGS=-static")
    if compiler == "zig":
        path = zig()
        options = ["c++", *options]
        compiler = str(path)
        settings += [f"-DCMAKE_{name.upper()}={script(name, f'{path} {name}')}" for name in ("ar", "ranlib")]
    compiler = script(f"c++-{target.name}", shlex.join([compiler, *options]))
    settings = ["-DSG_PYTHON=OFF", "-DSG_TESTS=ON", *settings]
    return build(f"cross/{target.name}", *settings, environment={"CXX": compiler})


def outcome(target: Target) -> tuple[bool, str]:
    """Whether all that was tried went well, and what it was."""
    if absent := missing(target):
        return True, f"not compiled: {absent} is missing"
    try:
        built = made(target)
    except subprocess.CalledProcessError:
        return False, "NOT COMPILED"
    if target.runner is None:
        return True, "compiled, not linked, not run"
    if target.runner and not shutil.which(target.runner):
        return True, f"compiled, not run: {target.runner} is missing"
    program = built / ("sg_tests" if target.system == "Linux" else "sg_tests.exe")
    command = [*([target.runner] if target.runner else []), str(program)]
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        # Wine's own files have a link to the whole machine among them, which a walk of the tree would follow.
        environment = {**os.environ, "WINEPREFIX": f"{folder}/wine", "WINEDEBUG": "-all"}
        tests = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    count = tests.stdout.splitlines()[-1] if tests.stdout else "no tests ran"
    if tests.returncode != 0:
        return False, f"compiled; TESTS FAIL: {count}\n{tests.stderr}"
    where = f" under {Path(target.runner).name}" if target.runner else ""
    return True, f"compiled; run{where}: {count}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", choices=[[], *(target.name for target in TARGETS)], metavar="NAME")
    names = parser.parse_args().names
    all_well = True
    for target in TARGETS:
        if names and target.name not in names:
            continue
        well, text = outcome(target)
        all_well &= well
        print(f"{target.name:22}{text}", flush=True)
    sys.exit(0 if all_well else 1)


if __name__ == "__main__":
    main()
