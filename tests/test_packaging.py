"""The places that configure wheels, the packed source and the image agree. `make wheel` builds and tries a wheel."""

from __future__ import annotations

import json
import os
import re
import sysconfig
import tomllib
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.version import Version

from tests.support.data import ROOT
from tests.support.processes import run

pytestmark = pytest.mark.thorough

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
WHEELS = PROJECT["tool"]["cibuildwheel"]


def test_python_npm_the_changelog_and_the_citation_state_one_version() -> None:
    npm = json.loads((ROOT / "sgmethod" / "javascript" / "package.json").read_text())["version"]
    changes = re.findall(r"^## (\d\S*) - (\d{4}-\d\d-\d\d)$", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE)
    cited = re.findall(r"^(?:version|date-released): (\S+)$", (ROOT / "CITATION.cff").read_text(), re.MULTILINE)
    assert PROJECT["project"]["version"] == changes[0][0]
    assert Version(npm) == Version(changes[0][0])
    assert tuple(cited) == changes[0]


def test_wheels_are_made_for_every_python_that_the_project_names() -> None:
    named = re.findall(r"Python :: 3\.(\d+)", "\n".join(PROJECT["project"]["classifiers"]))
    assert WHEELS["build"] == f"cp3{{{','.join(named)}}}-*"
    assert WHEELS["config-settings"] == {"wheel.py-api": "cp312"}  # the first stable ABI that nanobind can use
    python, _, script = WHEELS["test-command"].partition(" {project}/")
    assert (python, (ROOT / script).is_file()) == ("python", True)


def test_the_packed_source_and_the_image_hold_the_same() -> None:
    packed = PROJECT["tool"]["scikit-build"]["sdist"]["exclude"]
    image = (ROOT / ".dockerignore").read_text().splitlines()
    assert packed[0] == "/*"
    assert image[0] == "*"
    assert sorted(name.removeprefix("!/") for name in packed[1:]) == sorted(re.findall(r"!(\S+)", "\n".join(image)))


def test_the_image_installs_what_the_project_requires() -> None:
    """`make lock` renews the files."""
    extras = PROJECT["project"]["optional-dependencies"]
    served = [*PROJECT["project"]["dependencies"], *extras["service"], *extras["postgres"], *extras["s3"]]
    wanted = {"build": PROJECT["build-system"]["requires"], "slim": served, "torch": extras["torch"]}
    for file, requirements in wanted.items():
        text = (ROOT / "service" / "requirements" / f"{file}.txt").read_text()
        pins = re.findall(r"^([\w-]+)==([^ ]+) .*\\\n +--hash=sha256:", text, re.MULTILINE)
        for requirement in map(Requirement, requirements):
            versions = [version for name, version in pins if name == requirement.name]
            assert versions, f"{file}: {requirement}"
            assert all(map(requirement.specifier.contains, versions)), f"{file}: {requirement}"


def test_make_does_not_compile_again_what_pip_has_compiled(tmp_path: Path) -> None:
    """After Quick start's `pip install -e .`, `make serve` installs only packages, and says so when it compiles."""
    (editable,) = Path(sysconfig.get_path("purelib")).glob("_editable_*sgmethod.py")
    installed = tmp_path / "lib" / "python3.11" / "site-packages" / editable.name

    def plan() -> tuple[bool, bool]:
        done = run("make", "--dry-run", f"VENV={tmp_path}", tmp_path / ".service")
        assert done.status == 0, done.stderr
        return "--editable .'[service,heif]'" in done.stdout, "compiling the kernels" in done.stdout

    assert plan() == (True, True)
    installed.parent.mkdir(parents=True)
    installed.touch()
    assert plan() == (False, False)
    os.utime(installed, (0, 0))  # before the last change
    assert plan() == (True, True)
