"""AVIF."""

from __future__ import annotations

from sgmethod.io.kinds.format import Format, Writer

FORMAT = Format(
    "AVIF",
    (".avif", ".avifs"),
    ("PIL.AvifImagePlugin", "AvifImageFile"),
    brands=frozenset({b"avif", b"avis"}),
    pillow="11.3",
    threads=("PIL.AvifImagePlugin", "DEFAULT_MAX_THREADS", 1),
    writer=Writer(
        (".avif",),
        max_side=16_384,  # for libavif, which reads no side above 32,768
        options={"quality": 90, "subsampling": "4:4:4", "speed": 8},  # tagged as sRGB by code points
        media_type="image/avif",
        quality=75,
        quick={"speed": 9, "max_threads": 1},
    ),
)
