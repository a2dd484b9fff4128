"""The npm package's modules in Node, and packages from npm's registry."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import sgmethod
from tests.support.data import JAVASCRIPT, ROOT

# What a module finds in its global scope: `src`, where the package's modules lie, and what it is given.
_BEFORE = f"""
globalThis.src = "{JAVASCRIPT.as_uri()}";
globalThis.given = JSON.parse((await import("node:fs")).readFileSync(0));
"""


def node(script: str, given: Any = None, folder: Path = ROOT) -> str:
    """What a module prints that runs in a folder; it must end well."""
    return _run("node", "--input-type=module", "--eval", _BEFORE + script, folder=folder, given=json.dumps(given))


def answer_of(script: str, given: Any = None, folder: Path = ROOT) -> Any:
    """What a module prints as JSON."""
    return json.loads(node(script, given, folder))


def install(folder: Path, *packages: str | Path) -> None:
    """Install packages in a folder; skip the test where the registry is out of reach."""
    (folder / "package.json").write_text('{ "private": true, "type": "module" }')
    try:
        _run("npm", "install", "--silent", "--no-audit", "--no-fund", *map(str, packages), folder=folder)
    except AssertionError as error:
        pytest.skip(f"npm cannot install {' '.join(map(str, packages))}: {str(error)[-300:]}")


def packed() -> Path:
    """The package as npm installs it."""
    files = sorted((ROOT / "dist").glob("sgmethod-*.tgz"))
    if not files:
        pytest.skip("the npm package is not built: make npm, which needs Node and npm")
    return files[-1]


def assert_as_python(ours: np.ndarray, data: bytes, **view: Any) -> None:
    """Samples [H, W, 4] of a view of the file, as signed integers, within what docs/format.md allows two decoders: one
    level, and seldom. 1 sample of 12,960 is the most seen."""
    expected = sgmethod.open(data).pixels(**view)
    if expected.shape[2] == 3:
        expected = np.dstack([expected, np.full(expected.shape[:2], 255)])
    assert ours.shape == expected.shape
    difference = np.abs(ours - expected)
    assert difference.max() <= 1
    assert np.count_nonzero(difference) <= max(1, difference.size // 10_000)


def _run(*command: str, folder: Path, given: str = "") -> str:
    if shutil.which(command[0]) is None:
        pytest.skip(f"{command[0]} is not installed: sudo apt install nodejs npm")
    ran = subprocess.run(command, cwd=folder, input=given, capture_output=True, text=True, check=False, timeout=600)
    assert ran.returncode == 0, ran.stderr
    return ran.stdout
