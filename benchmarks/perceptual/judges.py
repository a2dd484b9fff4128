"""Metrics that chose nothing in the codec: ColorVideoVDP and Butteraugli's 3-norm.

They need the extra "judges" (PyPI's cvvdp, whose parameters are in its wheel), and libjxl's butteraugli_main (Debian's
libjxl-devtools). ColorVideoVDP: Mantiuk et al., 2024, in just-objectionable differences, on its usual display of 75
pixels per degree; 10 for the source itself. Butteraugli: on its usual display of 80 cd/m2; 0 for the source itself.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import tempfile
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import torch
from PIL import Image

from benchmarks.pictures import Pixels

BUTTERAUGLI = "butteraugli_main"
DISPLAY = "standard_4k"


def judge_versions() -> list[str]:
    """Names and versions of both, for a JSON; none where cvvdp is missing."""
    try:
        return [f"cvvdp-{version('cvvdp')} on {DISPLAY}", BUTTERAUGLI]
    except PackageNotFoundError:
        return []


class Judges:
    """Both metrics."""

    def __init__(self) -> None:
        """Raises SystemExit where one of them is not installed."""
        if shutil.which(BUTTERAUGLI) is None:
            raise SystemExit(f"the judges need {BUTTERAUGLI}: apt-get install libjxl-devtools")
        self._vdp = self._color_video_vdp()

    def __call__(self, picture: Pixels, source: Pixels) -> dict[str, float]:
        """Measure "butteraugli" and "cvvdp" of a picture [H, W, 3]."""
        with tempfile.TemporaryDirectory() as folder:
            paths = [f"{folder}/{name}.png" for name in ("source", "picture")]
            for path, pixels in zip(paths, (source, picture), strict=True):
                Image.fromarray(pixels).save(path, compress_level=1)
            told = subprocess.run([BUTTERAUGLI, *paths], capture_output=True, text=True, check=True).stdout
        norm = re.search(r"3-norm: ([\d.]+)", told)
        if norm is None:
            raise SystemExit(f"{BUTTERAUGLI} says {told!r}, which has no 3-norm")
        jod, _ = self._vdp.predict(picture, source, dim_order="HWC")
        return {"butteraugli": float(norm[1]), "cvvdp": float(jod)}

    def _color_video_vdp(self) -> Any:
        try:
            if torch.__version__.endswith("+cpu") and "+" not in version("torchvision"):
                # PyPI's torchvision cannot load its operators beside a PyTorch for CPUs alone, and fails to start where
                # they are unknown. ColorVideoVDP uses its blur, which needs none.
                library: Any = torch.library.Library("torchvision", "DEF")  # type: ignore[no-untyped-call]
                for name in ("nms", "qnms"):
                    library.define(f"{name}() -> ()")
                self._operators = library  # which lives as long as they do
            import pycvvdp
        except ImportError as error:
            raise SystemExit("the judges need cvvdp: pip install -e '.[judges]'") from error
        return pycvvdp.cvvdp(display_name=DISPLAY, heatmap=None, device=torch.device("cpu"))
