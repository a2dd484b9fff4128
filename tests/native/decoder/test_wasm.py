"""The decoder in WebAssembly, in Node: the pixels are Python's. Built by `make wasm`, without which it is skipped."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from tests.harness.data import ROOT
from tests.native.harness.decoders import SCRIPT, damaged_questions, differing, golden_questions

DECODER = ROOT / "build" / "wasm" / "decoder.js"
MOST_BYTES = 150_000
DAMAGED = 100


@pytest.fixture(scope="module")
def decoder() -> list[str]:
    node = shutil.which("node")
    if node is None:
        pytest.skip("Node is missing, so the decoder in WebAssembly is not tested: sudo apt install nodejs")
    module = DECODER.with_suffix(".wasm")
    sources = [path for path in (ROOT / "sgmethod" / "native").rglob("*") if path.suffix in (".cpp", ".h", ".js")]
    if not module.exists() or module.stat().st_mtime < max(path.stat().st_mtime for path in sources):
        pytest.skip("the decoder in WebAssembly is not built, or older than its sources, and so not tested: make wasm")
    return [node, str(SCRIPT), str(DECODER)]


def test_golden_files_and_views_are_drawn_as_python_draws_them(decoder: list[str], tmp_path: Path) -> None:
    assert differing(decoder, golden_questions(tmp_path)) == []


def test_damaged_files_are_refused_as_python_refuses_them(decoder: list[str], tmp_path: Path) -> None:
    assert differing(decoder, damaged_questions(tmp_path, DAMAGED)) == []


@pytest.mark.usefixtures("decoder")
def test_the_module_is_small() -> None:
    assert DECODER.with_suffix(".wasm").stat().st_size <= MOST_BYTES
