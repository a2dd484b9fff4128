"""Every number of the method, with where it comes from. No torch here: the service validates names with it.

Sections are those of the paper "Structure-Guided Allocation of 2D Gaussians for Image Representation and
Compression". Where the paper gives no number, the comment names the measurement that chose it, on the sample
photographs that scikit-image carries (docs/design.md).
"""

from __future__ import annotations

from dataclasses import dataclass, replace


@dataclass(frozen=True)
class OptimiserSettings:
    """Adam in each Gaussian's own frame: ours. Rates are relative changes per step."""

    mean_rate: float = 0.07
    factor_rate: float = 0.07
    color_rate: float = 0.035
    final_rate: float = 0.03  # the cosine schedule ends at this part of the rates
    beta1: float = 0.9
    beta2: float = 0.99
    min_scale_px: float = 0.3  # l1, l3 at least this: below it a Gaussian falls between pixel centres


@dataclass(frozen=True)
class PaperSettings(OptimiserSettings):
    """Hyper-parameters of profiles paper and baseline."""

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
    # Ours: energy of each Gaussian alone, in the fit. Large colours that cancel would not survive six bits each;
    # with it 28.9 -> 29.3 dB and 28.4 -> 28.8 dB on two photographs after quantisation (docs/design.md).
    lambda_e: float = 0.003

    # Schedule: ours.
    fit_steps: int = 4000
    tune_steps: int = 2500
    tune_rate: float = 0.5  # of the optimiser's rates
    bits_rate: float = 0.02
    # A range starts at these quantiles of its values: one outlier would coarsen all (28.6 -> 28.9 dB).
    range_quantile: float = 0.01
    range_rate: float = 1e-4  # of the range's width

    # Quantisation (sections III-C and IV-A)
    position_bits: int = 12
    adaptive_bitwidth: bool = True  # False: uniform at min_bitwidth (GSImage)
    min_bitwidth: int = 6
    max_bitwidth: int = 16
    mean_bitwidth: float = 7.5  # aimed at when a byte budget fixes the number of Gaussians
    codebook_decay: float = 0.8  # GSImage


@dataclass(frozen=True)
class RdSettings(OptimiserSettings):
    """Hyper-parameters of profile rd: ours (docs/design.md). Times are parts of the schedule."""

    steps: int = 1500
    start_share: float = 0.1  # of the expected Gaussians, placed by structure; the others grow where the error is
    growth_at: tuple[float, ...] = (0.03, 0.09, 0.15, 0.21, 0.27, 0.33, 0.39, 0.45, 0.55, 0.65)
    growth: float = 1.0  # at most this part of the Gaussians is added at once
    bits_of_new: float = 20.0  # a Gaussian is added where it gains more than so many bits are worth
    bits_of_dropped: float = 25.0  # and dropped at the end of the growth and after where its energy is worth less
    bits_of_nothing: float = 4.3  # likewise before: such a Gaussian rounds to nothing
    rate_weight: float = 2.0  # of the theoretical price of a bit
    color_solve_steps: int = 10  # conjugate-gradient steps for the colours of the start and of new Gaussians
    # While Gaussians are few a picture of half the size, or less, serves as well.
    halvings: int = 3
    pixels_per_gaussian: float = 20.0
    halved_until: float = 0.5
    whole_from: float = 0.8  # under a time limit too short for the whole picture before
    # Steering of the quantum towards a size or a PSNR
    steering_from: float = 0.12
    steering_exponent: float = 0.9
    steering_limit: float = 1.35  # the quantum's largest change at a time
    early_db: float = 2.0  # below the final PSNR, right when steering begins
    missed_db: float = 0.1  # Gaussians whose loss would take the PSNR so far below its goal stay
    trim_at: tuple[float, ...] = (0.72, 0.78, 0.82, 0.86, 0.9, 0.94, 0.97, 0.99)
    trim_exponent: float = 1.0
    excess: float = 0.5  # of bytes, or of Gaussians, over what was asked for at first
    finer_early: float = 4.0  # how many times finer a quantum that was given is at first
    excess_from: float = 0.45  # from here on both are given up,
    excess_until: float = 0.97  # and here they are gone
    most: float = 5.0  # Gaussians at any time, of those expected
    db_per_doubling: float = 2.5  # PSNR lost when the quantum doubles
    # The end: integers refined
    fit_share: float = 0.9  # of a time limit; what is left is for this
    refine_weight: float = 0.35  # of the theoretical price of a bit
    refine_sweeps: int = 6
    least_used: float = 0.985  # of the size; below, a finer quantum is tried
    size_tries: int = 4
    quantum_per_size: float = 1.4  # the quantum goes with about this power of the size's inverse
    far_from_size: float = 1.1  # a fit that was cut short: fewer Gaussians may be better than coarser ones
    psnr_tries: int = 7
    psnr_slack_db: float = 0.05


PAPER = PaperSettings()
BASELINE = replace(
    PAPER,
    structure_guided=False,
    lambda_g=0.0,
    position_bits=16,
    adaptive_bitwidth=False,
    mean_bitwidth=6.0,
)
RD = RdSettings()
PROFILES: dict[str, PaperSettings | RdSettings] = {"rd": RD, "baseline": BASELINE, "paper": PAPER}
PROFILE_NAMES = tuple(PROFILES)
DEFAULT_PROFILE = "rd"
