"""Every number of the method, with where it comes from. No torch here: the service validates names with it.

Sections are those of the paper "Structure-Guided Allocation of 2D Gaussians for Image Representation and
Compression". Where the paper gives no number, the comment names the measurement that chose it, on the sample
photographs that scikit-image carries (docs/notebook.md).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from numbers import Integral
from typing import Any, Literal, get_args

from sgmethod.budget import Budget
from sgmethod.errors import BudgetError

Tune = Literal["psnr", "visual"]
TUNES: tuple[Tune, ...] = get_args(Tune)
DEFAULT_TUNE: Tune = "visual"  # where a profile and a budget leave the choice


@dataclass(frozen=True)
class OptimiserSettings:
    """Adam in each Gaussian's own frame: ours. Rates are relative changes per step."""

    mean_rate: float = 0.07
    factor_rate: float = 0.07
    color_rate: float = 0.035
    final_rate: float = 0.03  # the cosine schedule ends at this part of the rates
    beta1: float = 0.9
    beta2: float = 0.99
    newton_steps: float = math.inf  # a step is at most so many of Gauss-Newton's, by the curvature of a Gaussian alone
    min_scale_px: float = 0.3  # l1, l3 at least this: below it a Gaussian falls between pixel centres


@dataclass(frozen=True)
class PaperSettings(OptimiserSettings):
    """Hyper-parameters of profiles paper and baseline."""

    # Structure-guided initialisation (section III-B)
    structure_guided: bool = True  # False: uniformly random start (GSImage)
    ratio: tuple[float, float, float] = (6.0, 2.0, 1.0)  # phi_1 : phi_2 : phi_3, section IV-A
    ratio_exponent: float = 10.0  # gamma, section IV-A
    ratio_start: int = 10_000  # n_0, section IV-A
    threshold_factor: float = 0.6455  # k of N_t = k (H W)^alpha; not in the paper: N_t = 70,000 at 768x512
    threshold_exponent: float = 0.9  # alpha; not in the paper: N_t x 4 from 0.6 to 2.8 megapixels
    shared_by_area: bool = True  # False: regions of a category have equally many Gaussians, whatever their area
    gaussians_per_region: int = 10  # SLIC regions follow the number of Gaussians
    compactness: float = 10.0  # of SLIC
    tensor_smoothing_px: float = 2.0  # window of the structure tensor that orients the start
    placement_power: float = 1.0  # density within a region ~ gradient magnitude ^ power
    orientation_gain: float = 1.0  # log of the start's aspect ratio at full coherence
    color_solve_steps: int = 10  # conjugate-gradient steps for the start's colours

    # Losses (sections III-D and III-E)
    lambda_g: float = 0.06  # geometry-consistent regularisation, section IV-A
    # Bitwidth loss, used where no byte budget sets the bitwidths: a tenth of the number in section IV-A, which on the
    # scale of our error leaves six bits to nearly all (docs/notebook.md).
    lambda_b: float = 0.00012
    lambda_r: float = 1.0  # commitment of colours to the codebooks (GSImage)
    # Ours: energy of each Gaussian alone, in the fit. Large colours that cancel would not survive six bits each;
    # with it 28.9 -> 29.3 dB and 28.4 -> 28.8 dB on two photographs after quantisation (docs/notebook.md).
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
class Times:
    """What is due when, in one run of profile rd's schedule. Times are parts of it, 0 to 1."""

    # Gaussians are added at these times, where each gains more than its bits are worth.
    growth_at: tuple[float, ...] = (0.03, 0.09, 0.15, 0.21, 0.27, 0.33, 0.39, 0.45, 0.55, 0.65)
    # The quantum moves towards the size or the PSNR asked for, at the times of growth and at these.
    trim_at: tuple[float, ...] = (0.72, 0.78, 0.82, 0.86, 0.9, 0.94, 0.97, 0.99)
    steering_from: float = 0.12
    early_db: float = 2.0  # when steering begins, a PSNR so far below the final one is right
    early_until: float = 0.45

    # Surplus: there may be more than the budget allows at first. Between these times it is given up.
    excess: float = 0.5  # a budget of 100 bytes, or Gaussians, allows 150 at first
    finer_early: float = 4.0  # a quantum that the budget gives is so many times finer at first
    excess_from: float = 0.45
    excess_until: float = 0.88

    # While Gaussians are few, half the size or less serves as well.
    halved_until: float = 0.6


# For a first look: few growths, none too many, and smaller pictures for longer.
QUICK = Times(
    growth_at=(0.03, 0.1, 0.2, 0.32, 0.46, 0.6), trim_at=(0.72, 0.8, 0.88, 0.94, 0.98), excess=0.0, halved_until=0.85
)

# Of a round: more Gaussians than can stay are added to a file that is as large as it may be, and those that gain least
# for their bits go.
ROUND = Times(
    growth_at=(0.0, 0.1, 0.2),
    trim_at=(0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.88, 0.94, 0.98),
    steering_from=0.0,
    early_db=0.0,
    excess=1.0,
    finer_early=1.35,
    excess_from=0.0,
    excess_until=0.6,
    halved_until=0.0,
)


@dataclass(frozen=True)
class RdSettings(OptimiserSettings):
    """Hyper-parameters of profile rd: ours. Times are parts of the schedule, 0 to 1.

    docs/notebook.md has the measurement behind each number.
    """

    tune: Tune = "psnr"  # what the file is to be good for: squared error, or the eye

    # Steps become short by newton_steps, so that rates may be high and fall little.
    mean_rate: float = 0.14
    factor_rate: float = 0.14
    color_rate: float = 0.14
    final_rate: float = 0.5
    newton_steps: float = 2.0
    min_scale_px: float = 0.5  # below it a Gaussian jumps from pixel to pixel
    steps: int = 250
    dense_steps: float = 2.25  # times the steps where many Gaussians a pixel are expected: they come to rest later
    sparse: float = 0.01  # Gaussians a pixel up to which `steps` are enough
    dense: float = 0.035  # and from which there are `dense_steps` times as many
    large_steps: float = 0.85  # times the steps for a large picture, whose last steps gain least for their time
    large_halved_until: float = 0.8  # for a large picture, if later than its times say
    large: tuple[float, float] = (1e6, 8e6)  # pixels; between them both go over to those of a large one
    color_solve_steps: int = 4  # conjugate-gradient steps for the colours of the start and of new Gaussians

    times: Times = Times()

    # Rounds after the first run of the schedule. A file is made after each so many, and the best of them is kept.
    rounds: tuple[int, ...] = (1,)
    round_times: Times = ROUND
    round_steps: float = 0.4  # of the first run's

    # Further runs, for sizes of their own, for pictures that are stiff and small
    ladder_pixels: int = 1 << 18  # of a picture, at most
    ladder: tuple[int, ...] = tuple(64 << doubled for doubled in range(13))  # bytes

    # Growth
    start_share: float = 0.1  # of the expected number of Gaussians; structure places so many, the others grow
    growth: float = 1.0  # new Gaussians at one time are at most this part of those that there are
    most: float = 5.0  # under a budget of bytes there are never more Gaussians than so many times the expected number
    most_hurried: float = 1.3  # the same where there is no time for the lowest effort, nor to fit any more
    # A new Gaussian's place is hidden by wider ones that gain more, of so many coarser sizes of the picture.
    hidden_by: int = 8  # all that there are
    hidden_by_visual: int = 2  # coarse errors then move the target, and are left for long
    bits_of_new: float = 20.0  # a new Gaussian takes away at least the error that so many bits are worth

    # A Gaussian is dropped when its own energy is worth fewer bits than this.
    bits_of_nothing: float = 4.3  # while Gaussians are added: what is worth less rounds to nothing in the file
    bits_of_dropped: float = 18.0  # from the last growth on
    missed_db: float = 0.1  # nothing is dropped that would take a PSNR so far below the one asked for
    rate_weight: float = 1.7  # price of a bit in the fit, in multiples of its theoretical price

    with_shear: bool = False  # shear is coded even where no Gaussian has any; of alpha a file does not say whether
    overshoot: float = 0.0  # how far beyond black and white the fit may be, which decoding clamps; for alpha

    # Size of the picture that is fitted
    halvings: int = 3
    pixels_per_gaussian: float = 20.0
    contrast_kept: float = 0.7  # of the picture's variance; a smaller picture that keeps less misses what matters

    # Rate control
    steering_exponent: float = 0.9  # at the times of growth
    trim_exponent: float = 1.0  # later
    steering_limit: float = 1.35  # the quantum's largest change at one time, as a factor
    db_per_doubling: float = 2.5  # PSNR that is lost when the quantum doubles

    # The end: one quantum for all, then integers are refined.
    fit_share: float = 0.9  # of a time limit; the rest is for the end
    refine_weight: float = 0.35  # price of a bit in refining, in multiples of its theoretical price
    refine_sweeps: int = 2  # over all Gaussians
    # Then, once for each round after the first, half of the Gaussians move to what rounding the others has left, and
    # all are refined again.
    relaxed_steps: int = 20
    relaxed_rate: float = 0.15
    relaxed_weight: float = 0.6  # price of a bit in these steps, in multiples of its theoretical price
    relaxed_gain: float = 0.005  # of a file's size that this is expected to spare, where a PSNR is asked for
    size_per_db: float = 0.3  # of it, by a PSNR above what is asked for
    least_used: float = 0.985  # of the bytes allowed; if refining leaves less in use, a finer quantum is tried
    size_tries: int = 4
    quantum_per_size: float = 1.4  # the quantum goes with about this power of the size's inverse
    far_from_size: float = 1.1  # of the bytes allowed; a fit that ends beyond was cut short, and also tries to drop
    psnr_tries: int = 7
    psnr_slack_db: float = 0.05  # so far above the PSNR asked for is near enough
    # A stiff picture's file, and one for a PSNR that is tiny or far above it, is the best of those with so many times
    # the quantum, and the price of a bit.
    searched_quanta: tuple[float, ...] = tuple(2 ** (step / 6) for step in range(-3, 10))
    searched_prices: tuple[float, ...] = (0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0)
    searched_nearer: tuple[float, ...] = (1 / 12, 1 / 24, 1 / 48, 1 / 96)  # octaves of the quantum, for small pictures
    searched_fits: int = 8  # of a tiny file; of others the best alone
    tiny_bytes: int = 400
    searched_bytes: int = 12_000  # of a stiff picture's file; in a larger one each Gaussian is worth little
    fillings: int = 16  # times, at most, that bytes which are left are filled
    # Grain that is hidden from the fit, and texture; of visual tuning alone.
    grain_hidden: float = 1.0  # of the strength of a cell's grain: detail that is no stronger is hidden as a whole
    grain_left: tuple[float, float] = (0.6, 0.85)  # of a cell's detail, by the fit: none is hidden below, all above
    grain_levels: tuple[float, float] = (4.0, 7.0)  # of 8 bits: the same by its strength; faint grain makes no needles
    texture_gain: tuple[float, float] = (0.8, 0.4)  # by octave, of a spread of texture_middle that is left
    texture_middle: float = 3.0  # levels of 8 bits
    texture_power: float = 0.5  # of other spreads, with which strengths go: much grain where much is left looks broken
    texture_most: float = 0.9  # of what is left
    texture_floor: float = 0.3  # levels of 8 bits; rounding two pictures leaves that much between them
    texture_quantile: float = 0.4  # of the blocks of a cell, by what is left in them
    texture_share: float = 0.05  # of a budget of bytes, at most
    least_gain: float = 0.1  # of what a finer quantum should gain; one that gains less is finer than the picture needs


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
# What profile rd does for an effort. Each above the default does all that the one below does, and then goes on.
EFFORTS: dict[int, dict[str, Any]] = {
    1: {
        "rounds": (0,),
        "steps": 75,
        "times": QUICK,
        "hidden_by": 1,
        "hidden_by_visual": 1,
        "refine_sweeps": 0,
        "size_tries": 0,
        "ladder_pixels": 0,
    },
    2: {"rounds": (0,), "steps": 130, "hidden_by": 2, "size_tries": 2, "ladder_pixels": 0},
    3: {"rounds": (0,), "steps": 180, "ladder_pixels": 0},
    4: {"rounds": (0,), "ladder_pixels": 0},
    5: {},
    6: {"rounds": (1, 2)},
    7: {"rounds": (1, 2, 5)},
    8: {"rounds": (1, 2, 5, 12)},
    9: {"rounds": (1, 2, 5, 12, 20)},
}
DEFAULT_EFFORT = 5
PROFILES: dict[str, PaperSettings | RdSettings] = {"rd": RD, "baseline": BASELINE, "paper": PAPER}
PROFILE_NAMES = tuple(PROFILES)
DEFAULT_PROFILE = "rd"


def with_size(settings: RdSettings, pixels: int) -> RdSettings:
    """The settings for a picture of so many pixels."""
    s, (small, large) = settings, settings.large
    share = min(max(math.log(pixels / small) / math.log(large / small), 0.0), 1.0)
    later = max(s.large_halved_until - s.times.halved_until, 0.0)
    times = replace(s.times, halved_until=s.times.halved_until + share * later)
    return replace(s, steps=round(s.steps * (1 - share * (1 - s.large_steps))), times=times)


def hurried(settings: RdSettings, pixels: int, steps: float) -> RdSettings:
    """The settings for a picture of so many pixels where there is time for so many steps: as they are if they need no
    more, or those of the highest effort below that needs no more, or of the lowest with few Gaussians."""
    lower = [replace(settings, **changes) for changes in reversed(EFFORTS.values()) if "steps" in changes]
    fewer = [sized for sized in (with_size(one, pixels) for one in lower) if sized.steps < settings.steps]
    choices = [settings, *fewer]
    lowest = replace(choices[-1], most=settings.most_hurried)
    return next((one for one in choices if one.steps <= steps), lowest)


def tuning(tune: str | None, profile: str, budget: Budget) -> Tune:
    """What an encode is tuned for: what is asked for, or what goes with profile and budget.

    Raises BudgetError for an unknown one, and for "visual" where there is only "psnr": with a budget in dB, and with
    profiles other than rd.
    """
    psnr_alone = budget.kind == "psnr" or not isinstance(PROFILES[profile], RdSettings)
    if tune is None:
        return "psnr" if psnr_alone else DEFAULT_TUNE
    if tune not in TUNES:
        raise BudgetError(f"unknown tuning {tune!r}; use one of {', '.join(TUNES)}")
    if tune == "visual" and psnr_alone:
        what = "a budget in dB" if budget.kind == "psnr" else f"profile {profile}"
        raise BudgetError(f"{what} goes with tuning for psnr alone")
    return TUNES[TUNES.index(tune)]


def checked_effort(effort: object) -> int:
    """One of EFFORTS. Raises BudgetError for anything else."""
    if isinstance(effort, bool) or not isinstance(effort, Integral) or effort not in EFFORTS:
        raise BudgetError(f"effort must be one of {min(EFFORTS)} to {max(EFFORTS)}, got {effort!r}")
    return int(effort)


def with_effort(settings: PaperSettings | RdSettings, effort: int) -> PaperSettings | RdSettings:
    """The settings for an effort of EFFORTS. Raises BudgetError for any but the default where there is no choice: with
    profiles other than rd."""
    if isinstance(settings, RdSettings):
        return replace(settings, **EFFORTS[effort])
    if effort != DEFAULT_EFFORT:
        raise BudgetError("an effort goes with profile rd alone")
    return settings
