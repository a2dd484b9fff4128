"""Files as text for an attribute or a JSON string: base64url of all bytes but the first.

The first byte is the same in every file; the second has the version, so texts of later versions can be recognised.
"""

from __future__ import annotations

import base64
import binascii

from sgmethod.bitstream.container import parse, version_of
from sgmethod.bitstream.stream import SIGNATURE
from sgmethod.errors import BitstreamError

TEXT_PREFIXES = (b"w", b"x", b"y", b"z")  # of texts, and of no file: w up to version 3, the others for later ones


def to_text(data: bytes) -> str:
    """Convert a file to text, 4 characters of A-Z a-z 0-9 - _ for 3 bytes. Raises BitstreamError for other data."""
    version_of(data)
    return base64.urlsafe_b64encode(data[1:]).rstrip(b"=").decode()


def from_text(text: str) -> bytes:
    """Convert text to a file. Raises BitstreamError unless it is the whole text of an intact file."""
    try:
        data = bytes([SIGNATURE]) + base64.b64decode(text.encode() + b"=" * (-len(text) % 4), b"-_", validate=True)
    except (binascii.Error, UnicodeEncodeError) as error:
        raise BitstreamError("this is not the text of an .sg file") from error
    parse(data)
    if to_text(data) != text:  # padding, or bits after the last byte
        raise BitstreamError("this is not the text of an .sg file")
    return data


def file_of(data: bytes) -> bytes:
    """Convert a file's text, perhaps with a line end, to the file, and return other data. Raises BitstreamError."""
    return from_text(data.decode("latin-1").strip()) if data.startswith(TEXT_PREFIXES) else data
