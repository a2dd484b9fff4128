"""Pillow's defaults for what is read here, whatever another library has set for the whole process.

Pillow reads these two from its modules, and takes no arguments for them. A value that is not the default is replaced by
an equal one that has the default to a thread while it reads here: no other thread notices.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import ModuleType

from PIL import Image, ImageFile

# None, for no limit, is left: ImageLimits has a lower one than Pillow.
DEFAULTS: tuple[tuple[ModuleType, str, int], ...] = (
    (ImageFile, "LOAD_TRUNCATED_IMAGES", False),
    (Image, "MAX_IMAGE_PIXELS", 1024 * 1024 * 1024 // 4 // 3),
)


class _Here(threading.local):
    reads = False


_here = _Here()


class _Value(int):
    """A number, but the default to a thread that reads here: what Pillow does with it is `not a`, `2 * a`, `b > a`."""

    default: int

    def _seen(self) -> int:
        return self.default if _here.reads else int(self)

    def __bool__(self) -> bool:
        return self._seen() != 0

    def __rmul__(self, factor: int) -> int:
        return factor * self._seen()

    def __lt__(self, other: int) -> bool:
        return self._seen() < other


@contextmanager
def pillow_defaults() -> Iterator[None]:
    """Let this thread find Pillow's defaults."""
    for module, name, default in DEFAULTS:
        found = getattr(module, name)
        if isinstance(found, int) and not isinstance(found, _Value) and found != default:
            value = _Value(found)
            value.default = default
            setattr(module, name, value)
    before, _here.reads = _here.reads, True
    try:
        yield
    finally:
        _here.reads = before
