"""Check callers' numbers, and convert them to Python's: NumPy's small integers overflow in sums and products."""

from __future__ import annotations

import math
from numbers import Integral, Real
from typing import SupportsFloat, SupportsIndex

from sgmethod.errors import SgError

AnyInt = SupportsIndex  # int, and NumPy's
AnyFloat = SupportsFloat  # numbers of any kind


def finite_number(value: object) -> int | float | None:
    """Convert a number to a Python int or float; None if it is not a finite number."""
    if isinstance(value, Integral):
        return int(value)
    if not isinstance(value, Real):
        return None
    try:
        number = float(value)
    except OverflowError:  # a Fraction may exceed every float
        return None
    return number if -math.inf < number < math.inf else None  # torch.compile does not support math.isfinite


def checked_integer(value: object, name: str, minimum: int, maximum: int, error: type[SgError] = SgError) -> int:
    """Return a whole number from minimum to maximum as a Python int. Raises `error` for anything else."""
    if not isinstance(value, Integral) or not minimum <= int(value) <= maximum:
        raise error(f"{name} must be a whole number from {minimum} to {maximum}, got {value!r}")
    return int(value)
