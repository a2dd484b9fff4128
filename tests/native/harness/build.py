"""Builds the native code by cmake, in folders that stay, so that only what has changed is compiled."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path

from tests.support.data import ROOT

BUILDS = ROOT / "build"
BIN = Path(sys.executable).parent  # of the environment, whose programs come first
PATH = f"{BIN}{os.pathsep}{os.environ['PATH']}"


def tool(name: str) -> str:
    """Where a program lies."""
    return shutil.which(name, path=PATH) or name


def build(name: str, *options: str, environment: dict[str, str] | None = None) -> Path:
    """The folder of a build with these options of sgmethod/native/CMakeLists.txt. Raises CalledProcessError."""
    folder = BUILDS / name
    ninja = shutil.which("ninja", path=PATH)
    generator = ["-G", "Ninja"] if ninja and not (folder / "Makefile").exists() else []
    python = f"-DPython_EXECUTABLE={sys.executable}"
    everything = {**os.environ, "PATH": PATH, **(environment or {})}
    command = [tool("cmake"), "-S", "sgmethod/native", "-B", str(folder), *generator, python, *options]
    for step in (command, [tool("cmake"), "--build", str(folder), "--parallel"]):
        done = subprocess.run(step, cwd=ROOT, env=everything, capture_output=True, text=True, check=False)
        if done.returncode != 0:
            print(done.stdout, done.stderr, file=sys.stderr)
            done.check_returncode()
    return folder


def nanobind() -> str:
    """The option that says where nanobind lies."""
    found = subprocess.run(
        [sys.executable, "-m", "nanobind", "--cmake_dir"], capture_output=True, text=True, check=True
    )
    return f"-Dnanobind_DIR={found.stdout.strip()}"


def layout(built: Path) -> Path:
    """A folder to import from: this package and these tests as they are, with the kernels of a build."""
    folder = built / "python"
    for source in (ROOT / "sgmethod", ROOT / "sgmethod" / "native"):
        package = folder / source.relative_to(ROOT)
        package.mkdir(parents=True, exist_ok=True)
        for path in source.iterdir():
            link = package / path.name
            if path.name != "native" and path.suffix != ".so" and not link.is_symlink():
                link.symlink_to(path)
    (kernels,) = built.glob("_native.*.so")
    links = {name: ROOT / name for name in ("tests", "benchmarks")} | {f"sgmethod/native/{kernels.name}": kernels}
    for name, target in links.items():
        (folder / name).unlink(missing_ok=True)
        (folder / name).symlink_to(target)
    return folder


def imports(folder: Path) -> str:
    """PYTHONPATH for a Python that is started with -S in a layout, so that no finder knows of the installed kernels."""
    return f"{folder}{os.pathsep}{sysconfig.get_path('platlib')}"
