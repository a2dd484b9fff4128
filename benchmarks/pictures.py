"""Which files of a folder are pictures to measure with."""

from __future__ import annotations

from pathlib import Path

SUFFIXES = {".png", ".jpg", ".jpeg", ".webp", ".tif", ".tiff", ".bmp"}


def pictures_in(folder: Path) -> list[Path]:
    """The folder's pictures, by name; none if it has none. Raises OSError if it cannot be read."""
    return sorted(path for path in folder.iterdir() if path.suffix.lower() in SUFFIXES)
