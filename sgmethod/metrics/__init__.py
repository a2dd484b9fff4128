"""How close two pictures are: PSNR and MS-SSIM (pixels); SSIMULACRA 2 (looks); LPIPS and DISTS (perceptual)."""

from sgmethod.metrics.looks import ssimulacra2
from sgmethod.metrics.pixels import MIN_SIDE, ms_ssim, psnr

__all__ = ["MIN_SIDE", "ms_ssim", "psnr", "ssimulacra2"]
