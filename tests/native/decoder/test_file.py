"""Whole files without Python (sgmethod/native/file): the pixels are Python's, and what Python refuses is refused."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.native.harness.build import build
from tests.native.harness.decoders import ask, damaged_questions, differing, golden_questions

pytestmark = pytest.mark.thorough

DAMAGED = 400


@pytest.fixture(scope="module")
def decoder() -> list[str]:
    return [str(build("core", "-DSG_PYTHON=OFF", "-DSG_TESTS=ON") / "sg_decode")]


def test_golden_files_and_views_are_drawn_as_python_draws_them(decoder: list[str], tmp_path: Path) -> None:
    assert differing(decoder, golden_questions(tmp_path)) == []


def test_damaged_files_are_refused_as_python_refuses_them(decoder: list[str], tmp_path: Path) -> None:
    questions = damaged_questions(tmp_path, DAMAGED)
    assert differing(decoder, questions) == []
    refused = sum(answer is None for answer in ask(decoder, questions))
    assert 20 < refused < DAMAGED - 20
