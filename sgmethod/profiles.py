"""Every number of the method, with where it comes from. No torch here: the service validates names with it.

Sections are those of the paper "Structure-Guided Allocation of 2D Gaussians for Image Representation and
Compression". Where the paper gives no number, the comment names the measurement that chose it, on the sample
photographs that scikit-image carries (docs/design.md).
"""

from __future__ import annotations

from dataclasses import dataclass, replace


@dataclass(frozen=True)
class Settings:
    """Hyper-parameters of one profile."""

    # Structure-guided initialisation (section III-B)
    structure_guided: bool = True  # False: uniformly random start (GSImage)
    ratio: tuple[float, float, float] = (6.0, 2.0, 1.0)  # phi_1 : phi_2 : phi_3, section IV-A
    ratio_exponent: float = 10.0  # gamma, section IV-A
    ratio_start: int = 10_000  # n_0, section IV-A
    threshold_factor: float = 0.58  # k of N_t = k (H W)^alpha; not in the paper: N_t = 70,000 at 768x512
    threshold_exponent: float = 0.9  # alpha; not in the paper: N_t x 4 from 0.6 to 2.8 megapixels
    gaussians_per_region: int = 10  # SLIC regions follow the number of Gaussians
    compactness: float = 10.0  # of SLIC
    tensor_smoothing_px: float = 2.0  # window of the structure tensor that orients the start
    placement_power: float = 1.0  # density within a region ~ gradient magnitude ^ power
    orientation_gain: float = 1.0  # log of the start's aspect ratio at full coherence
    color_solve_steps: int = 10  # conjugate-gradient steps for the start's colours

    # Losses (sections III-D and III-E)
    lambda_g: float = 0.06  # geometry-consistent regularisation, section IV-A
    lambda_b: float = 0.0012  # bitwidth loss, section IV-A; used where no byte budget sets the bitwidths
    lambda_r: float = 1.0  # commitment of colours to the codebooks (GSImage)

    # Optimiser: ours. Steps are in the Gaussian's own frame, so rates are relative changes per step.
    fit_steps: int = 5000
    tune_steps: int = 3000
    mean_rate: float = 0.07
    factor_rate: float = 0.07
    color_rate: float = 0.035
    tune_rate: float = 0.5  # of the rates above
    bits_rate: float = 0.02
    range_rate: float = 1e-4  # of the range's width
    final_rate: float = 0.03  # the cosine schedule ends at this part of the rates
    beta1: float = 0.9
    beta2: float = 0.99
    min_scale_px: float = 0.3  # l1, l3 at least this: below it a Gaussian falls between pixel centres

    # Quantisation (sections III-C and IV-A)
    position_bits: int = 12
    adaptive_bitwidth: bool = True  # False: uniform at min_bitwidth (GSImage)
    min_bitwidth: int = 6
    max_bitwidth: int = 16
    mean_bitwidth: float = 7.5  # aimed at when a byte budget fixes the number of Gaussians
    codebook_decay: float = 0.8  # GSImage


PAPER = Settings()
BASELINE = replace(
    PAPER,
    structure_guided=False,
    lambda_g=0.0,
    position_bits=16,
    adaptive_bitwidth=False,
    mean_bitwidth=6.0,
)
PROFILES = {"baseline": BASELINE, "paper": PAPER}
PROFILE_NAMES = tuple(PROFILES)
DEFAULT_PROFILE = "paper"
