"""Groups of settings shared by several profiles."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, get_args

Tune = Literal["psnr", "fidelity", "visual"]
Superpixels = Literal["skimage", "opencv"]
TUNES: tuple[Tune, ...] = get_args(Tune)


@dataclass(frozen=True)
class OptimiserSettings:
    """Settings of Adam in each Gaussian's own frame (ours). Rates are relative changes per step."""

    mean_rate: float = 0.07
    factor_rate: float = 0.07
    color_rate: float = 0.035
    final_rate: float = 0.03  # factor on the rates at the end of the cosine schedule
    beta1: float = 0.9
    beta2: float = 0.99
    newton_steps: float = math.inf  # longest step, in steps of Gauss-Newton with a diagonal matrix
    min_scale_px: float = 0.3  # least l1 and l3: a smaller Gaussian falls between pixel centres


@dataclass(frozen=True)
class StartSettings:
    """Settings of structure-guided initialisation (paper, section III-B)."""

    structure_guided: bool = True  # False: uniformly random places (GaussianImage)
    # Ours: placed by gradient within a region, with scales by that density, and along edges.
    follows_gradient: bool = False
    ratio: tuple[float, float, float] = (6.0, 2.0, 1.0)  # phi_1 : phi_2 : phi_3, section IV-A
    ratio_exponent: float = 10.0  # gamma, section IV-A
    ratio_start: int = 10_000  # n_0, section IV-A
    threshold_factor: float = 0.6455  # k of N_t = k (H W)^alpha; not in the paper: N_t = 70,000 at 768x512
    threshold_exponent: float = 0.9  # alpha; not in the paper: N_t x 4 from 0.6 to 2.8 megapixels
    shared_by_area: bool = True  # False: regions of a category get equally many Gaussians, whatever their area
    gaussians_per_region: int = 10  # SLIC regions follow the number of Gaussians
    compactness: float = 10.0  # of SLIC: its balance of distance and colour
    superpixels: Superpixels = "skimage"  # the library whose SLIC it is
    tensor_smoothing_px: float = 2.0  # standard deviation of the structure tensor's window, which orients the start


ADAM = OptimiserSettings()
STRUCTURE = StartSettings()
