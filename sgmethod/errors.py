"""Errors and warnings that a caller can expect.

SgError                 base of all errors that this package raises, with one clear sentence
├── ImageError          the input is not an image that can be read, or exceeds the limits
├── BitstreamError      the bytes are not an intact .sg file
├── ViewError           the scale, region or prefix is invalid for the picture
├── GaussiansError      the arrays are not valid Gaussians, or no file can hold them
├── BudgetError         the budget is invalid, or too small for any file
├── ServerError         the service cannot be reached, refuses, or fails to encode
├── NativeModuleError   the compiled kernels are missing; the message says how to build them
└── MissingPackageError a package is missing (also an ImportError); the message says how to install it

ImageWarning            something was dropped from the image, and the rest is used
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar


class SgError(Exception):
    """Base of every error this package raises on purpose."""


class ImageError(SgError):
    """The input image cannot be read, or exceeds the stated limits."""


class BitstreamError(SgError):
    """The bytes are not an intact .sg file."""


class ViewError(SgError):
    """The scale, region or prefix is invalid for the picture."""


class GaussiansError(SgError):
    """The arrays are not valid Gaussians, or no file can hold them."""


class BudgetError(SgError):
    """The budget is invalid, or too small for any file."""


class ServerError(SgError):
    """The service cannot be reached, refuses the request, or failed to encode."""


class NativeModuleError(SgError):
    """The compiled kernels are not installed."""


class MissingPackageError(SgError, ImportError):
    """A package of an extra is not installed."""


@contextmanager
def extra(name: str) -> Iterator[None]:
    """Raise MissingPackageError if an import fails because the extra `name` is not installed."""
    try:
        yield
    except ImportError as error:
        raise MissingPackageError(f"an extra package is needed ({error}): pip install 'sgmethod[{name}]'") from error


class ImageWarning(UserWarning):
    """Something was dropped from the image: further pictures, transparency, a damaged profile."""


NOTES: ContextVar[list[str] | None] = ContextVar("notes", default=None)  # of the innermost noted()


@contextmanager
def noted() -> Iterator[list[str]]:
    """Collect what this thread would warn of within a block, one sentence each, instead of warning of it."""
    notes: list[str] = []
    before = NOTES.set(notes)
    try:
        yield notes
    finally:
        NOTES.reset(before)
