"""OpenCV from any of its packages, imported with a message that says how to install it."""

from __future__ import annotations

from sgmethod.errors import MissingPackageError

try:
    import cv2

    _ = cv2.__version__  # missing if another package's removal left only the folder
except (ImportError, AttributeError) as error:
    raise MissingPackageError(
        f"OpenCV, which encoding needs, cannot be imported ({error}): "
        "pip install --force-reinstall --no-deps opencv-contrib-python-headless"
    ) from error

__all__ = ["cv2"]
