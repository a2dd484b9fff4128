"""What callers give, as Python's own: NumPy's small numbers keep their type in sums and products, and wrap round."""

from __future__ import annotations

import math
import os
from numbers import Integral, Real
from pathlib import Path

from sgmethod.errors import SgError


def own_number(value: object) -> int | float | None:
    """A number as Python's int or float; None for what is no finite number."""
    if isinstance(value, Integral):
        return int(value)
    if not isinstance(value, Real):
        return None
    try:
        number = float(value)
    except OverflowError:  # of a fraction
        return None
    return number if math.isfinite(number) else None


def whole(value: object, name: str, least: int, most: int, error: type[SgError] = SgError) -> int:
    """A whole number from least to most as Python's int. Raises error for anything else."""
    if not isinstance(value, Integral) or not least <= int(value) <= most:
        raise error(f"{name} must be a whole number from {least} to {most}, got {value!r}")
    return int(value)


def own_path(path: str | os.PathLike[str], error: type[SgError] = SgError) -> Path:
    """A path. Raises error for a name that no file can have."""
    name = os.fsdecode(path)
    try:
        if b"\0" not in os.fsencode(name):
            return Path(name)
    except UnicodeEncodeError:
        pass
    raise error(f"no file can have the name {name!r}")
