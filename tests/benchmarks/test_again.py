"""Published rows, made once more."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import pytest

from benchmarks.again import Made, again, made
from benchmarks.pictures import photograph
from benchmarks.rd.codecs import Sg
from sgmethod import decode, encode
from sgmethod.metrics import psnr

RD = {"codec": "rd", "image": "fog.png", "max_bpp": 0.25, "quality": None, "effort": 5}
CONVERGENCE = {"method": "rd", "setting": "", "picture": "fog", "megapixels": 4.0}


@pytest.mark.parametrize(
    ("row", "how"),
    [
        (RD, Made(Sg("rd"), 0.25, "fog.png", None)),
        (RD | {"codec": "rd fidelity"}, Made(Sg("rd", "fidelity"), 0.25, "fog.png", None)),
        (RD | {"codec": "rd effort 9", "effort": 9}, Made(Sg("rd", effort=9), 0.25, "fog.png", None)),
        (
            RD | {"codec": "rd one quality", "max_bpp": None, "quality": 40},
            Made(Sg("rd", one_quality=True), 40, "fog.png", None),
        ),
        (RD | {"codec": "avif grain", "effort": None}, None),
        (RD | {"codec": "paper", "effort": None}, None),
        (CONVERGENCE, Made(Sg("rd"), 0.5, "fog", 4.0)),
        (
            CONVERGENCE | {"method": "rd fidelity", "setting": "effort 3"},
            Made(Sg("rd", "fidelity", effort=3), 0.5, "fog", 4.0),
        ),
        (CONVERGENCE | {"setting": "4 s"}, None),
        (CONVERGENCE | {"method": "paper"}, None),
        (CONVERGENCE | {"method": "avif", "setting": "6"}, None),
        (CONVERGENCE | {"method": "rd until", "setting": "avif 4"}, None),
    ],
)
def test_how_a_row_was_made(row: dict[str, Any], how: Made | None) -> None:
    assert made(row, 0.5) == how


def test_rows_that_are_alike(tmp_path: Path) -> None:
    pixels = photograph(48)
    cv2.imwrite(str(tmp_path / "fog.png"), cv2.cvtColor(pixels, cv2.COLOR_RGB2BGR))
    data = encode(pixels, bpp=1, tune="psnr").data
    row = {"bytes": len(data), "psnr": psnr(decode(data), pixels)}
    one = Made(Sg("rd"), 1, "fog.png", None)
    assert again(one, tmp_path, row)["alike"]
    assert not again(one, tmp_path, row | {"psnr": row["psnr"] + 0.001})["alike"]
    assert not again(one, tmp_path, row | {"bytes": len(data) - 1})["alike"]
