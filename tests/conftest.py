"""How much hypothesis tries: little in `make test`, much in `make thorough`; and a fixture that all tests share."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import pytest
from hypothesis import HealthCheck, settings

from sgmethod.native import native

ALWAYS: dict[str, Any] = {
    "deadline": None,
    "derandomize": True,
    "database": None,
    "suppress_health_check": list(HealthCheck),
}
settings.register_profile("quick", max_examples=100, **ALWAYS)
settings.register_profile("thorough", max_examples=4000, **ALWAYS)
settings.load_profile("quick")


@pytest.fixture
def set_threads() -> Iterator[Callable[[int], None]]:
    """Sets the number of the kernels' threads, which afterwards is as it was."""
    before = native.thread_count()
    yield native.set_thread_count
    native.set_thread_count(before)
