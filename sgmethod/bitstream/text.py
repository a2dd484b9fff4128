"""A file as text that an attribute or a JSON string can hold: base64url of all its bytes but the first.

The first byte says no more than that this is a file; the second has the version, so that later ones can be told apart.
"""

from __future__ import annotations

import base64
import binascii

from sgmethod.bitstream.container import parse, version_of
from sgmethod.bitstream.stream import NO_LIMITS, SIGNATURE, Limits
from sgmethod.errors import BitstreamError

FIRST = b"w"  # character of a text of versions 1 to 3, and of no file


def to_text(data: bytes) -> str:
    """The text of a file: 4 characters for 3 bytes, of A-Z a-z 0-9 - _ alone. Raises BitstreamError for anything but a
    file."""
    version_of(data)
    return base64.urlsafe_b64encode(data[1:]).rstrip(b"=").decode()


def from_text(text: str, limits: Limits = NO_LIMITS) -> bytes:
    """The file of a text. Raises BitstreamError for anything but the whole text of an intact file within the limits."""
    try:
        data = bytes([SIGNATURE]) + base64.b64decode(text.encode() + b"=" * (-len(text) % 4), b"-_", validate=True)
    except (binascii.Error, UnicodeEncodeError) as error:
        raise BitstreamError("this is not the text of an .sg file") from error
    parse(data, limits)
    if to_text(data) != text:  # padding, or bits behind the last byte
        raise BitstreamError("this is not the text of an .sg file")
    return data


def file_of(data: bytes) -> bytes:
    """The file, where data are its text, as in a file with a line end. Raises BitstreamError as from_text() does."""
    return from_text(data.decode("latin-1").strip()) if data[:1] == FIRST else data
