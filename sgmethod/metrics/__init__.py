"""Measures of similarity: PSNR and MS-SSIM (pixels.py), SSIMULACRA 2 (visual.py). advice.py finds better formats."""

from sgmethod.metrics.pixels import MS_SSIM_SIDE, ms_ssim, psnr
from sgmethod.metrics.visual import ssimulacra2

__all__ = ["MS_SSIM_SIDE", "ms_ssim", "psnr", "ssimulacra2"]
