"""How fast several pictures are converted, and how long the rest will take."""

from __future__ import annotations

import io
import os
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import BinaryIO

from sgmethod.cli.naming import Conversion
from sgmethod.cli.terminal import remaining
from sgmethod.io import formats
from sgmethod.io.formats import FORMATS
from sgmethod.io.opening import ImageLimits
from sgmethod.many.run import Tally

START_PIXELS = 100_000  # no encode is free: one of so many pixels takes twice as long for each as one of a megapixel

HEADER_BYTES = 1 << 16


class Throughput:
    """The throughput of a run over these pictures; the rest of it is estimated by their pixels."""

    def __init__(self, pictures: Sequence[str]) -> None:
        found = {picture: pixels_of(picture) for picture in set(pictures)}
        known = [pixels for pixels in found.values() if pixels is not None]
        usual = sum(known) / max(len(known), 1)
        self._weights = {
            picture: START_PIXELS + (usual if pixels is None else pixels) for picture, pixels in found.items()
        }
        self._count, self._all = len(pictures), sum(self._weights[picture] for picture in pictures)
        self._done = 0.0

    def after(self, outcome: Conversion, tally: Tally) -> str:
        """Count an outcome and format it, with the time left once as much is done as an average picture.

        A failure is no measure of the others.
        """
        weight = self._weights[outcome.input]
        if outcome.error:
            self._count, self._all = self._count - 1, self._all - weight
        else:
            self._done += weight
        is_measure = self._done and self._done * self._count >= self._all
        left_s = tally.seconds * (self._all / self._done - 1) if is_measure else None
        return throughput_text(tally.per_second) + remaining(left_s)


def pixels_of(picture: str) -> int | None:
    """Number of a picture's pixels by its header; None if that does not tell."""
    if not Path(picture).is_file():  # a pipe can be read only once
        return None
    try:
        with warnings.catch_warnings(action="ignore"), Path(picture).open("rb") as file:
            kind = formats.name_of(file.read(256))
            file.seek(0)
            width, height = _size_by_header(kind, file) if FORMATS[kind].reads_whole else _size(kind, file)
        ImageLimits().check(width, height)
    except Exception:  # of any reader: the encode itself says what is wrong
        return None
    return width * height


def _size_by_header(kind: str, file: BinaryIO) -> tuple[int, int]:
    """Size by a header's worth of the file, with zeros for the rest of it, which parsers of headers only skip."""
    head = file.read(HEADER_BYTES)
    try:
        return _size(kind, io.BytesIO(head.ljust(os.fstat(file.fileno()).st_size, b"\0")))
    except Exception:  # the header is longer, or not all at the start
        return _size(kind, io.BytesIO(head + file.read()))


def _size(kind: str, file: BinaryIO) -> tuple[int, int]:
    if (header_of := FORMATS[kind].header) is not None:
        header = header_of(file.read())
        return header.width, header.height
    with formats.reader_of(kind)(file) as image:
        return image.size


def throughput_text(per_second: float) -> str:
    """Format a throughput as seconds a picture or, if they take less than one, as pictures a second."""
    if 0 < per_second < 1:
        return f"{1 / per_second:.3g} s a picture"
    return f"{per_second:{'.3g' if per_second < 100 else ',.0f'}} pictures/s"
