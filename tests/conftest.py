"""How much hypothesis tries: little in `make test`, much in `make thorough`; and a fixture that all tests share."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings
from PIL import Image

from sgmethod.native import native
from tests.support.data import golden_path
from tests.support.pictures import photo

# Torch's, when it is imported: most arrays here are so small that a second thread only costs time.
os.environ.setdefault("OMP_NUM_THREADS", "1")
settings.register_profile(
    "quick", max_examples=100, deadline=None, derandomize=True, database=None, suppress_health_check=list(HealthCheck)
)
settings.register_profile("thorough", settings.get_profile("quick"), max_examples=4000)
settings.load_profile("quick")


@pytest.fixture
def set_threads() -> Iterator[Callable[[int], None]]:
    """Sets the number of the kernels' threads, which afterwards is as it was."""
    before = native.thread_count()
    yield native.set_thread_count
    native.set_thread_count(before)


@pytest.fixture
def files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with photo.png, of 128 x 96 pixels, and picture.sg, of 48 x 40, which is the working directory."""
    monkeypatch.chdir(tmp_path)
    Image.fromarray(photo()).save("photo.png")
    (tmp_path / "picture.sg").write_bytes(golden_path("v2-color.sg").read_bytes())
    return tmp_path
