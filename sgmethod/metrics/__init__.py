"""Measures of likeness: PSNR and MS-SSIM (pixels.py); SSIMULACRA 2 (looks.py); LPIPS and DISTS (perceptual.py)."""

from sgmethod.metrics.looks import ssimulacra2
from sgmethod.metrics.pixels import MS_SSIM_SIDE, ms_ssim, psnr

__all__ = ["MS_SSIM_SIDE", "ms_ssim", "psnr", "ssimulacra2"]
