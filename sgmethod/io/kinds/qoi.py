"""QOI."""

from __future__ import annotations

from sgmethod.io.kinds.format import Format

FORMAT = Format("QOI", (".qoi",), ("PIL.QoiImagePlugin", "QoiImageFile"), rb"qoif")
