"""Measures of similarity: PSNR (pixels.py) and SSIMULACRA 2 (visual.py). advice.py finds better formats."""

from sgmethod.metrics.pixels import psnr
from sgmethod.metrics.visual import ssimulacra2

__all__ = ["psnr", "ssimulacra2"]
