"""Size of a profile's smallest file, known before a picture is fitted."""

from __future__ import annotations

from sgmethod.bitstream.v1 import CODEBOOK_STAGES, COLOR_INDEX_BITS, file_bytes
from sgmethod.bitstream.v2 import SMALLEST_ALPHA, SMALLEST_FILE
from sgmethod.settings.paper import PaperSettings
from sgmethod.settings.rd import RdSettings


def smallest_file(settings: RdSettings | PaperSettings, *, has_alpha: bool = False) -> int:
    """Bytes of the smallest file that a profile writes for the largest picture."""
    if isinstance(settings, RdSettings):
        return SMALLEST_FILE + (SMALLEST_ALPHA if has_alpha else 0)
    groups = settings.max_bitwidth - settings.min_bitwidth + 1 if settings.adaptive_bitwidth else 1
    record = 2 * settings.position_bits + 3 * settings.min_bitwidth + CODEBOOK_STAGES * COLOR_INDEX_BITS
    return file_bytes(record, groups)
