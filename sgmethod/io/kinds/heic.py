"""HEIC, read by pillow-heif; libheif turns the picture and crops it to its aperture."""

from __future__ import annotations

from sgmethod.io.kinds.format import Format

FORMAT = Format(
    "HEIC",
    (".heic", ".heif", ".hif"),
    ("pillow_heif", "HeifImageFile"),
    brands=frozenset({b"heic", b"heix", b"heim", b"heis", b"hevc", b"hevx", b"mif1", b"msf1"}),
    extra="heif",
    lists_tiles=False,
    turns=True,
    threads=("pillow_heif.options", "DECODE_THREADS", 1),
)
