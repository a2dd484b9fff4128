""".sg files for Pillow: Image.open("photo.sg") and image.save("photo.sg", bpp=0.3), once sgmethod is imported.

The format's name is "SGM", for image.save(file, "SGM") and Image.open(file, formats=["SGM"]).
"""

from __future__ import annotations

import io
from typing import IO, TYPE_CHECKING, Any

from PIL import Image, ImageFile, UnidentifiedImageError

from sgmethod.errors import SgError

if TYPE_CHECKING:
    from sgmethod.decoder import SgFile

FORMAT = "SGM"
OPTIONS = (
    *("bpp", "bytes", "quality", "psnr", "gaussians", "budget"),
    *("profile", "tune", "effort", "time_limit_s", "on_progress"),
)


class SgImageFile(ImageFile.ImageFile):
    """An .sg file opened by Pillow, drawn when loaded; thumbnail() draws it directly at the size needed.

    >>> with Image.open("photo.sg") as photo:
    ...     photo.thumbnail((64, 64))
    ...     photo.size
    (64, 48)
    """

    format = FORMAT
    format_description = "Photograph as 2D Gaussians"
    _file: SgFile
    _scale = 1.0

    def _open(self) -> None:
        from sgmethod.decoder import SgFile

        assert self.fp is not None
        try:
            self._file = SgFile(self.fp.read())
        except SgError as error:
            raise UnidentifiedImageError(str(error)) from error
        self._mode = "RGBA" if self._file.has_alpha else "RGB"
        self._set_size(self._file.size)

    def _set_size(self, size: tuple[int, int]) -> None:
        self._size = size
        self.tile = [ImageFile._Tile("raw", (0, 0, *size), 0, self._mode)]

    def draft(self, mode: str | None, size: tuple[int, int] | None) -> tuple[str, tuple[int, int, float, float]] | None:
        """Reduce the size at which the picture will be drawn, but not below `size`. The mode stays as it is."""
        from sgmethod.view import MIN_SCALE, View

        if size is None or not self.tile:
            return None
        width, height = self._file.size
        self._scale = min(max(size[0] / width, size[1] / height, MIN_SCALE), 1.0)
        self._set_size(View(self._scale).size(width, height))
        return self.mode, (0, 0, *self.size)

    def load(self) -> Any:
        """Draw the picture, once. Raises OSError for a file that would take unbounded time to draw."""
        if self.tile:
            try:
                pixels = self._file.pixels(self._scale)
            except SgError as error:
                raise OSError(str(error)) from error
            if self.fp is not None and self._exclusive_fp:
                self.fp.close()
            self.fp = io.BytesIO(pixels.tobytes())
        return super().load()

    def load_seek(self, pos: int) -> None:
        """Do nothing: load() provides the pixels from their start."""


def _save(image: Image.Image, file: IO[bytes], _filename: str | bytes) -> None:
    """Save with those arguments of sgmethod.encode that are in OPTIONS, ignoring others as other formats do."""
    from sgmethod.codec import encode

    file.write(encode(image, **{name: value for name, value in image.encoderinfo.items() if name in OPTIONS}).data)


def register() -> None:
    """Register .sg files with Pillow."""
    # Files of later versions too, so that the error names their version.
    Image.register_open(FORMAT, SgImageFile, lambda prefix: b"\xd3\xc0" < prefix[:2] < b"\xd3\xd0")
    Image.register_save(FORMAT, _save)
    Image.register_extension(FORMAT, ".sg")
    Image.register_mime(FORMAT, "application/octet-stream")  # as in the service
