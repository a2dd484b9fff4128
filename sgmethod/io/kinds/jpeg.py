"""JPEG, read by Pillow's class alone: Image.open would take one with further pictures for another format."""

from __future__ import annotations

from PIL.JpegImagePlugin import JpegImageFile

from sgmethod.io.kinds.format import Format, Writer


class JpegReader(JpegImageFile):
    """Pillow's reader, except that it leaves out the resolution in EXIF data, of whose damage it would warn."""

    def _read_dpi_from_exif(self) -> None:
        pass


FORMAT = Format(
    "JPEG",
    (".jpg", ".jpeg", ".jpe", ".jfif"),
    (__name__, "JpegReader"),
    rb"\xff\xd8\xff",
    writer=Writer(
        (".jpg", ".jpeg"),
        has_alpha=False,
        max_side=65_500,  # of libjpeg, which prints a line of its own
        options={"quality": 95, "subsampling": "4:4:4"},
        profile=True,
        media_type="image/jpeg",
        quality=90,
    ),
)
