"""The golden files, and whether pixels are those of one."""

from __future__ import annotations

import hashlib
import json
from functools import cache

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from tests.support.data import golden, golden_path

GOLDEN = golden()


@cache
def _hashes() -> dict[str, dict[str, str]]:
    """Those of the default profile; others have pictures."""
    hashes: dict[str, dict[str, str]] = json.loads(golden_path("v2-hashes.json").read_text())
    return hashes


def is_golden(name: str, pixels: NDArray[np.uint8]) -> bool:
    """Whether pixels [H, W, 3] are exactly what the golden file of that name decodes to."""
    if name in _hashes():
        return hashlib.sha256(pixels.tobytes()).hexdigest() == _hashes()[name]["pixels"]
    return np.array_equal(pixels, np.asarray(Image.open(golden_path(f"{name}.png"))))
