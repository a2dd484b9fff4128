"""Small tensors, for which a second thread of torch only costs time; and the examples' files."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
import torch
from PIL import Image

from tests.harness.data import PHOTOGRAPHS, golden_path


@pytest.fixture(scope="package", autouse=True)
def one_thread() -> Iterator[None]:
    """While these tests run."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.fixture
def files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with photo.png, of 128 x 96 pixels, and picture.sg, of 48 x 40, which is the working directory."""
    monkeypatch.chdir(tmp_path)
    Image.open(PHOTOGRAPHS / "kodim23-crop.png").convert("RGB").save("photo.png")
    (tmp_path / "picture.sg").write_bytes(golden_path("v2-color.sg").read_bytes())
    return tmp_path
