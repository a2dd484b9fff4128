"""GIF, whose first frame may be smaller than its screen."""

from __future__ import annotations

from sgmethod.io.kinds.format import Format

FORMAT = Format("GIF", (".gif",), ("PIL.GifImagePlugin", "GifImageFile"), rb"GIF8[79]a", lists_tiles=False)
