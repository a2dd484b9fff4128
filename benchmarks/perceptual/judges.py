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
from importlib.metadata import version
from pathlib import Path
from typing import Any

import torch
from PIL import Image

from benchmarks.pictures import Pixels

BUTTERAUGLI = "butteraugli_main"
DISPLAY = "standard_4k"


class Judges:
    """Both metrics. The last source lies in a folder of its own until another one is given."""

    def __init__(self) -> None:
        """Raises SystemExit where one of them is not installed."""
        if shutil.which(BUTTERAUGLI) is None:
            raise SystemExit(f"the judges need {BUTTERAUGLI}: apt-get install libjxl-devtools")
        self._vdp = self._color_video_vdp()
        self._source: Pixels | None = None
        self._folder = tempfile.TemporaryDirectory()

    def __call__(self, picture: Pixels, source: Pixels) -> dict[str, float]:
        """Measure "butteraugli" and "cvvdp" of a picture [H, W, 3]."""
        folder = Path(self._folder.name)
        if self._source is not source:
            self._source = source
            Image.fromarray(source).save(folder / "source.png", compress_level=1)
        Image.fromarray(picture).save(folder / "picture.png", compress_level=1)
        command = [BUTTERAUGLI, str(folder / "source.png"), str(folder / "picture.png")]
        told = subprocess.run(command, capture_output=True, text=True, check=True).stdout
        norm = re.search(r"3-norm: ([\d.]+)", told)
        if norm is None:
            raise SystemExit(f"{BUTTERAUGLI} says {told!r}, which has no 3-norm")
        jod, _ = self._vdp.predict(picture, source, dim_order="HWC")
        return {"butteraugli": float(norm[1]), "cvvdp": float(jod)}

    def _color_video_vdp(self) -> Any:
        try:
            if torch.version.cuda is None and "+" not in version("torchvision"):
                # PyPI's torchvision cannot load its operators beside a PyTorch for CPUs alone, and fails to start where
                # they are unknown. ColorVideoVDP uses its blur, which needs none.
                self._operators = torch.library.Library("torchvision", "DEF")
                for name in ("nms", "qnms"):
                    self._operators.define(f"{name}() -> ()")
            import pycvvdp
        except ImportError as error:
            raise SystemExit("the judges need cvvdp: pip install -e '.[judges]'") from error
        return pycvvdp.cvvdp(display_name=DISPLAY, heatmap=None, device=torch.device("cpu"))
