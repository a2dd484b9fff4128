"""WebP."""

from __future__ import annotations

from sgmethod.io.kinds.format import Format, Writer

FORMAT = Format(
    "WebP",
    (".webp",),
    ("PIL.WebPImagePlugin", "WebPImageFile"),
    rb"RIFF....WEBP",
    lists_tiles=False,
    writer=Writer(
        (".webp",),
        max_side=16_383,
        options={"quality": 95},
        profile=True,
        media_type="image/webp",
        quality=85,
        quick={"method": 0},
    ),
)
