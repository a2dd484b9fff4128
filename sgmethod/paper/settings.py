"""Settings of profile paper.

Sections refer to the paper "Structure-Guided Allocation of 2D Gaussians for Image Representation and Compression".
Numbers without a section are ours: docs/notebook has the measurement behind each.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from sgmethod.settings.shared import ADAM, OptimiserSettings


@dataclass(frozen=True)
class StartSettings:
    """Settings of structure-guided initialisation (paper, section III-B)."""

    structure_guided: bool = True  # False: uniformly random places (GaussianImage)
    ratio: tuple[float, float, float] = (6.0, 2.0, 1.0)  # phi_1 : phi_2 : phi_3, section IV-A
    ratio_exponent: float = 10.0  # gamma, section IV-A
    ratio_start: int = 10_000  # n_0, section IV-A
    threshold_factor: float = 0.6455  # k of N_t = k (H W)^alpha; not in the paper: N_t = 70,000 at 768x512
    threshold_exponent: float = 0.9  # alpha; not in the paper: N_t x 4 from 0.6 to 2.8 megapixels
    gaussians_per_region: int = 10  # SLIC regions follow the number of Gaussians
    compactness: float = 10.0  # of SLIC: its balance of distance and colour


STRUCTURE = StartSettings()


@dataclass(frozen=True)
class PaperSettings:
    """Hyper-parameters of profile paper."""

    profile: ClassVar[str] = "paper"
    start: StartSettings = STRUCTURE
    optimiser: OptimiserSettings = ADAM  # ours: GaussianImage's Adan takes 50,000 steps

    # Losses (sections III-D and III-E)
    lambda_g: float = 0.06  # geometry-consistent regularisation, section IV-A
    lambda_b: float = 0.0012  # bitwidth loss, section IV-A
    lambda_r: float = 1.0  # commitment of colours to the codebooks (GaussianImage)

    # Schedule: ours.
    fit_steps: int = 4000
    tune_steps: int = 2500
    tune_rate: float = 0.5  # factor on the optimiser's rates
    bits_rate: float = 0.02
    range_rate: float = 0.003  # in multiples of the range's width
    # The ranges of l1, l2 and l3 start at these quantiles; 0 means the smallest and the largest value, as in
    # GaussianImage. Our optimiser makes a few Gaussians wider than the picture, which would make all steps coarse.
    range_quantile: float = 0.01

    # Quantisation (sections III-C and IV-A)
    position_bits: int = 12
    adaptive_bitwidth: bool = True  # False: uniform at min_bitwidth
    min_bitwidth: int = 6
    max_bitwidth: int = 16
    start_bitwidth: float = 8.0  # not in the paper
    printed_gradient: bool = False  # of the bitwidth, as equation 7 prints it
    codebook_decay: float = 0.8  # GaussianImage

    # Budgets of bytes, which the paper does not have: ours.
    mean_bitwidth: float = 6.2  # expected; it decides how many Gaussians a budget has room for
    bits_by_budget: bool = False  # bitwidths are raised, too, until they use the budget, which replaces lambda_b


PAPER = PaperSettings()
