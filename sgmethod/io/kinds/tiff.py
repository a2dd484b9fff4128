"""TIFF."""

from __future__ import annotations

from sgmethod.io.kinds.format import Format

FORMAT = Format(
    "TIFF",
    (".tif", ".tiff"),
    ("PIL.TiffImagePlugin", "TiffImageFile"),
    rb"II\*\0|MM\0\*|II\+\0",
    turns=True,
)
