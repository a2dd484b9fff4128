"""Version 4 of the file (profile rd), a draft: version 3 with shapes that no fineness of the steps clips, drawn in a
pyramid. Other flags and models will follow; until then a file of version 4 is read by the release that wrote it alone.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

from sgmethod.bitstream.v3 import StreamV3
from sgmethod.scene import Scene


@dataclass(frozen=True)
class StreamV4(StreamV3):
    """A version 4 file. The fields are those of StreamV3."""

    VERSION: ClassVar[int] = 4

    def scene(self, prefix: float = 1.0) -> Scene:
        """What is to be drawn, as far as that part of the payload tells. Raises BitstreamError."""
        return replace(super().scene(prefix), pyramid=True)
