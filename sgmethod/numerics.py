"""Arithmetic that ignores the caller's NumPy settings for floating-point errors."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import ParamSpec, TypeVar

import numpy as np

Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")


def quiet(function: Callable[Arguments, Result]) -> Callable[Arguments, Result]:
    """Decorate a public entry point: NumPy neither raises nor warns inside, as underflow is expected there.

    NumPy keeps this setting for each thread, so what the threads of a pool do needs it too.
    """

    @wraps(function)
    def entered(*arguments: Arguments.args, **options: Arguments.kwargs) -> Result:
        with np.errstate(all="ignore"):  # not as a decorator: with NumPy 1, threads would share what it restores
            return function(*arguments, **options)

    return entered
