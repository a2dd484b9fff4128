"""The examples' files."""

from __future__ import annotations

from pathlib import Path

import pytest
from PIL import Image

from benchmarks.harness.data import golden_path
from benchmarks.harness.pictures import photo


@pytest.fixture
def files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with photo.png, of 128 x 96 pixels, and picture.sg, of 48 x 40, which is the working directory."""
    monkeypatch.chdir(tmp_path)
    Image.fromarray(photo()).save("photo.png")
    (tmp_path / "picture.sg").write_bytes(golden_path("v2-color.sg").read_bytes())
    return tmp_path
