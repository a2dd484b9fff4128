"""How close two pictures are: PSNR and MS-SSIM (pixels); SSIMULACRA 2, LPIPS and DISTS (perceptual)."""

from sgmethod.metrics.pixels import MIN_SIDE, ms_ssim, psnr

__all__ = ["MIN_SIDE", "ms_ssim", "psnr"]
