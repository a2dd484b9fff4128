"""How much hypothesis tries: little in `make test`, much in `make thorough`; and a fixture that all tests share."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator

import pytest
from hypothesis import HealthCheck, settings

from sgmethod.native import native

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
