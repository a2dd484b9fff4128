"""Size of a profile's smallest file, known before a picture is fitted."""

from __future__ import annotations

from sgmethod.bitstream.v1 import file_bytes, record_bits
from sgmethod.bitstream.v2 import SMALLEST_ALPHA, SMALLEST_FILE
from sgmethod.settings.paper import PaperSettings
from sgmethod.settings.rd import RdSettings


def smallest_file(settings: RdSettings | PaperSettings, *, has_alpha: bool = False) -> int:
    """Bytes of the smallest file that a profile writes for the largest picture."""
    if isinstance(settings, RdSettings):
        return SMALLEST_FILE + (SMALLEST_ALPHA if has_alpha else 0)
    return file_bytes(record_bits(settings.position_bits, settings.min_bitwidth), 1)
