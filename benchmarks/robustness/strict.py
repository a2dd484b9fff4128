"""Hard pictures in a program that turns warnings into errors, and has NumPy raise on underflow."""

from __future__ import annotations

import warnings
from functools import partial

import numpy as np

from benchmarks.robustness.case import Case, Cases, Found
from benchmarks.robustness.stiff.pictures import PICTURES
from sgmethod import Budget, BudgetError, decode, encode
from sgmethod.profiles import TUNES

RULE = "encodes that np.errstate(all='raise') or a filter of errors ends, of the bits per pixel and tunings tried"
BPP = (0.3, 1.0, 3.0)


def cases() -> Cases:
    """Every hard picture."""
    for name in PICTURES:
        yield Case(name, RULE, 0, partial(failures, name))


def failures(name: str) -> Found:
    """Count the encodes of a picture that fail, and give the first error."""
    pixels, errors = PICTURES[name](), []
    with np.errstate(all="raise"), warnings.catch_warnings():
        warnings.simplefilter("error")
        for bpp in BPP:
            for tune in TUNES:
                try:
                    decode(encode(pixels, Budget("bpp", bpp), tune=tune).data)
                except BudgetError:  # a picture of a few pixels has less than the smallest file
                    pass
                except (ArithmeticError, Warning) as error:
                    errors.append(f"{type(error).__name__}: {error}")
    return len(errors), errors[0] if errors else ""
