"""What there is to say of a picture format."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sgmethod.io.chunks import brands

Compress = Callable[[memoryview], bytes]  # makes a zlib stream (RFC 1950)


class Header(NamedTuple):
    """A file's header: size in pixels as displayed, whether it is animated, bits per sample."""

    width: int
    height: int
    is_animated: bool
    depth: int


@dataclass(frozen=True)
class Writer:
    """How pixels become a file.

    suffixes: that ask for it, the usual one first; has_alpha: else a transparent picture is composited over white;
    max_side: of the format, or of its library; options: of Pillow's writer, unless others are given; profile: whether
    sRGB is stated by an ICC profile; write: in place of Pillow's writer.
    media_type: None if no browser shows such files, and so no service makes them; quality: a service's, None if the
    format is lossless; quick: other options of Pillow's writer for a service.
    """

    suffixes: tuple[str, ...]
    has_alpha: bool = True
    max_side: int = 2**31 - 1
    options: Mapping[str, Any] = field(default_factory=dict)
    profile: bool = False
    write: Callable[[NDArray[np.uint8], Compress], bytes] | None = None
    media_type: str | None = None
    quality: int | None = None
    quick: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Format:
    """A picture format that is read.

    suffixes: of its files, the usual one first; magic: pattern of a file's first bytes; brands: or one of these in its
    box ftyp; reader: module and class, of Pillow or a plugin; extra: of this
    package, which brings that class; pillow: the first version of Pillow that has it, if that is newer than ours.
    lists_tiles: whether the reader lists the parts of the picture that the file has, so that missing ones are noticed;
    turns: whether it applies the orientation itself; threads: a module, its name for the decoder's threads, and the
    number that stands for one.
    header: parser of headers, for a reader that decodes all pixels on opening; prepared: file as the reader takes it.
    """

    name: str
    suffixes: tuple[str, ...]
    reader: tuple[str, str]
    magic: bytes = b"(?!)"
    brands: frozenset[bytes] = frozenset()
    extra: str = ""
    pillow: str = ""
    lists_tiles: bool = True
    turns: bool = False
    threads: tuple[str, str, int] | None = None
    header: Callable[[bytes], Header] | None = None
    prepared: Callable[[bytes], bytes] = bytes
    writer: Writer | None = None

    def begins(self, data: bytes) -> bool:
        """Whether a file begins as one of this format."""
        return re.match(self.magic, data, re.DOTALL) is not None or not self.brands.isdisjoint(brands(data))
