"""The command line with profile paper and its files."""

from __future__ import annotations

import pytest
import torch

from sgmethod.paper import encode as paper
from tests.cli import conftest
from tests.cli.conftest import Run
from tests.cli.test_cli import assert_info_shows, assert_refused

in_folder, run = conftest.in_folder, conftest.run


def test_info(run: Run) -> None:
    lines = {"picture": "40 x 56 pixels", "position bits": "12"}
    assert_info_shows(run, "v1-paper", "headers positions covariances colors", lines)


def test_an_encode_that_torch_has_no_memory_for(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(paper, "run", lambda *_: torch.empty(1 << 55, dtype=torch.uint8))
    assert_refused(run("encode", "photo.png", "out.sg", "--profile", "paper"), "out of memory")
