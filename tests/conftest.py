"""How much hypothesis tries: a little in `make test`, much in `make thorough`, and always the same."""

from __future__ import annotations

from typing import Any

from hypothesis import HealthCheck, settings

ALWAYS: dict[str, Any] = {
    "deadline": None,
    "derandomize": True,
    "database": None,
    "suppress_health_check": list(HealthCheck),
}
settings.register_profile("quick", max_examples=100, **ALWAYS)
settings.register_profile("thorough", max_examples=4000, **ALWAYS)
settings.load_profile("quick")
