"""Settings of profile rd (ours). Times are fractions of a run of the schedule, 0 to 1."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

from sgmethod.settings.shared import OptimiserSettings

# newton_steps shortens the steps, so rates may be high and need not fall much.
NEWTON_ADAM = OptimiserSettings(
    mean_rate=0.14, factor_rate=0.14, color_rate=0.14, final_rate=0.5, newton_steps=2.0, min_scale_px=0.5
)


@dataclass(frozen=True)
class Times:
    """Times of events in one run of profile rd's schedule."""

    # Gaussians are added at these times, wherever one gains more than its bits are worth.
    growth_at: tuple[float, ...] = (0.03, 0.09, 0.15, 0.21, 0.27, 0.33, 0.39, 0.45, 0.55, 0.65)
    # The quantum moves towards the requested size or PSNR at the times of growth and at these.
    trim_at: tuple[float, ...] = (0.72, 0.78, 0.82, 0.86, 0.9, 0.94, 0.97, 0.99)
    steering_from: float = 0.12
    early_db: float = 2.0  # when steering begins, it aims this far below the final PSNR
    early_until: float = 0.45
    quality_at: tuple[float, ...] = (0.33, 0.65, 0.86)  # few, because measuring takes as long as several steps

    # Surplus over the budget at first, given up between these times.
    excess: float = 0.5  # a budget of 100 bytes, or Gaussians, allows 150 at first
    finer_early: float = 4.0  # a quantum set by the budget is divided by this at first
    excess_from: float = 0.45
    excess_until: float = 0.88

    # The end of the time with few pixels, and the start of the time with many (PyramidSettings).
    few_until: float = 0.6
    many_from: float = 0.85
    # Before a file is made, the price of a bit falls from this stage on: it has decided which Gaussians stay, and would
    # only keep their colours too faint.
    settling_from: float = 0.97
    # A fit comes apart if one step multiplies its error by this, as where many wide Gaussians overlap: it then takes
    # that stage's steps again, shorter, as all later ones.
    apart: float = math.inf


# Effort 1: few growths, no surplus, and smaller pictures for longer.
QUICK = Times(
    growth_at=(0.03, 0.1, 0.2, 0.32, 0.46, 0.6),
    trim_at=(0.72, 0.8, 0.88, 0.94, 0.98),
    excess=0.0,
    few_until=0.85,
    quality_at=(0.2, 0.32, 0.46, 0.6, 0.88),
)

# A round after the first run: more Gaussians than fit are added to a file of full size, and those that gain least for
# their bits are dropped.
ROUND = Times(
    growth_at=(0.0, 0.1, 0.2),
    quality_at=(0.5, 0.88),
    trim_at=(0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.88, 0.94, 0.98),
    steering_from=0.0,
    early_db=0.0,
    excess=1.0,
    finer_early=1.35,
    excess_from=0.0,
    excess_until=0.6,
    few_until=0.0,
    apart=1.25,  # it has no time to recover, as the first run has, where long steps gain more than they lose
)


@dataclass(frozen=True)
class Effort:
    """A level of effort of profile rd. Each above the default does all that the one below does, and then goes on."""

    steps: int = 250  # of the first run of the schedule
    times: Times = Times()
    rounds: tuple[int, ...] = (1,)  # rounds after the first run at which a file is made; the best file is kept
    # Coarser sizes whose gains can hide a place of growth: all, if the target does not move. Few for the eye, as growth
    # does not see that coarse errors count more.
    suppression_levels: int = 8
    suppression_levels_for_eye: int = 2
    refine_sweeps: int = 2  # over all Gaussians
    size_tries: int = 4  # further files with finer quanta, if refining leaves bytes unused


EFFORTS: dict[int, Effort] = {
    1: Effort(75, QUICK, (0,), suppression_levels=1, suppression_levels_for_eye=1, refine_sweeps=0, size_tries=0),
    2: Effort(130, rounds=(0,), suppression_levels=2, size_tries=2),
    3: Effort(180, rounds=(0,)),
    4: Effort(rounds=(0,)),
    5: Effort(),
    6: Effort(rounds=(1, 2)),
    7: Effort(rounds=(1, 2, 5)),
    8: Effort(rounds=(1, 2, 5, 12)),
    9: Effort(rounds=(1, 2, 5, 12, 20)),
}
DEFAULT_EFFORT = 5


@dataclass(frozen=True)
class ScheduleSettings:
    """Length of a run, depending on the picture and its Gaussians."""

    dense_steps: float = 2.25  # factor on the steps for many Gaussians per pixel, which converge more slowly
    sparse: float = 0.01  # Gaussians per pixel up to which an effort's steps are enough
    dense: float = 0.035  # Gaussians per pixel from which there are `dense_steps` times as many
    large: tuple[float, float] = (1e6, 8e6)  # pixels; between them the next two are phased in
    large_steps: float = 0.85  # factor on the steps for a large picture, whose last steps gain least for their time
    large_few_until: float = 0.8  # Times.few_until of a large picture, if later
    round_steps: float = 0.4  # in multiples of the first run's
    round_times: Times = ROUND
    rounds_for_psnr: int = 2  # beyond those of the effort, while a PSNR is missed
    rounds_for_quality: int = 1


@dataclass(frozen=True)
class PyramidSettings:
    """The size of the picture used by each part of the fit."""

    smallest_side: int = 32  # pixels; smaller pictures are not halved
    # Pixels per Gaussian: while there are few, for most steps, and for the last steps and the file's integers.
    pixels_while_few: float = 20.0
    pixels_per_gaussian: float = 100.0
    pixels_in_the_end: float = 250.0
    # Samples: the energy of a narrower Gaussian depends on its position between the samples of a smaller picture.
    narrowest: float = 0.75
    contrast_kept: float = 0.7  # part of the picture's variance; smaller pictures that keep less are not used


@dataclass(frozen=True)
class PlaceSettings:
    """The initial Gaussians."""

    share: float = 0.1  # of the expected number; the others are added by growth
    fewest: int = 4


@dataclass(frozen=True)
class FitSettings:
    """The optimiser's steps."""

    optimiser: OptimiserSettings = NEWTON_ADAM
    rate_weight: float = 1.7  # price of a bit, in multiples of its theoretical price
    settling_weight: float = 0.5  # the same from Times.settling_from on
    stable_length: float = 0.5  # factor on the longest step of a fit that came apart (Times.apart)


@dataclass(frozen=True)
class DensifySettings:
    """Growth: where and how many Gaussians are added."""

    growth: float = 1.0  # most new Gaussians at one time, as a part of the existing ones
    fewest: int = 4  # allowed regardless of `growth`
    limit: float = 5.0  # of Gaussians under a budget of bytes, in multiples of the expected number
    bits_of_new: float = 20.0  # a new Gaussian must reduce the error by what this many bits are worth
    color_solve_steps: int = 4  # conjugate-gradient steps
    saturated: float = 0.001  # new Gaussians, as a part of all; finding fewer ends the search at that price


@dataclass(frozen=True)
class PruneSettings:
    """Pruning: a Gaussian is dropped if its own energy is worth fewer bits than this."""

    worthless_bits: float = 4.3  # during growth: a Gaussian worth less rounds to nothing in the file
    bits_of_dropped: float = 21.0  # from the last growth on
    missed_db: float = 0.1  # no Gaussians are dropped if that would take the PSNR this far below the requested one


@dataclass(frozen=True)
class RateSettings:
    """Steering of the quantum during the fit, and the search for it at the end."""

    bits_per_gaussian: float = 30.0  # first guess
    gaussians_per_pixel: float = 0.0023  # first guess, times the quantum
    min_pixels: int = 20  # per Gaussian in a first guess; growth may go beyond
    max_bytes: int = 12  # that a pixel can use, with one Gaussian for each pixel
    gaussians_quantum: float = 3.2 * 2 ** (-85 / 16)  # for a budget of Gaussians: about 1.2 bpp on photographs
    coarsest_of_aim: float = 0.4  # first quantum
    quality_quantum: tuple[float, float] = (70.0, 0.16)  # a quality, and a typical quantum of photographs there
    # Pixels of a side, and factor on the quantum of smaller pictures, which SSIMULACRA 2 judges more harshly.
    quality_small: tuple[int, float] = (113, 0.25)
    steering_exponent: float = 0.9  # at the times of growth
    trim_exponent: float = 1.0  # later
    steering_limit: float = 1.35  # largest change of the quantum at one time, as a factor
    quality_limit: float = 1.8  # the same when SSIMULACRA 2 is measured, which is seldom
    quality_refined_db: float = 0.35  # least gain of refining
    quality_tries: int = 5  # instead of aim_tries
    db_per_doubling: float = 2.5  # PSNR lost when the quantum doubles
    min_used: float = 0.985  # of the allowed bytes; if refining uses less, a finer quantum is tried
    quantum_per_size: float = 1.4  # the quantum is about proportional to this power of the size's inverse
    overshoot_ratio: float = 1.1  # of the allowed bytes; a larger fit was cut short: fewer Gaussians are tried too
    aim_tries: int = 7
    slack_db: float = 0.05  # a PSNR this far above the requested one is close enough
    min_gain: float = 0.1  # part of the expected gain of a finer quantum; if it gains less, it is finer than needed
    missed_db: float = 0.1  # if a PSNR is out of reach, one this far below the best seen is enough


@dataclass(frozen=True)
class RefineSettings:
    """The search over the file's integers."""

    weight: float = 0.35  # price of a bit, in multiples of its theoretical price
    # Once for each round after the first, half of the Gaussians are refitted to what the rounded other half leaves, and
    # all are refined again.
    relaxed_steps: int = 20
    relaxed_rate: float = 0.15
    relaxed_weight: float = 0.6  # price of a bit in these steps, in multiples of its theoretical price
    relaxed_gain: float = 0.005  # expected saving, as a part of the file's size, for a budget in dB
    size_per_db: float = 0.3  # further saving, as a part of the size, per dB above the requested PSNR
    max_spared: float = 0.05  # largest saving, as a part of the size
    # Where a file is exact already, smaller ones are tried: with these shares of the Gaussians, after some steps of
    # this rate, on at most so many pixels in all; and with a quantum that is coarser by these factors. Seen for any
    # budget that suffices: a dot on a plain picture takes 47 to 56 bytes instead of 56 to 105, a step of one level 29
    # to 40 instead of 114 to 372.
    exact_shares: tuple[float, ...] = (0.7, 0.9)
    exact_steps: int = 100
    exact_rate: float = 0.4
    exact_pixels: int = 1 << 20
    exact_coarser: tuple[float, ...] = (2**0.5, 2**0.25)
    exact_tries: int = 40  # limit on files with a coarser quantum; it shrinks as a picture grows beyond exact_pixels


@dataclass(frozen=True)
class VisibilitySettings:
    """Masking of errors by detail (fitting/visibility.py)."""

    shrink: int = 4  # detail is measured on a picture reduced by this, where SSIMULACRA 2 weighs it most
    window: float = 1.5  # sigma of the window, in its samples
    power: float = 0.5  # visibility falls with this power of the variance
    seen_levels: float = 9.0  # of 255: detail that is fainter hides nothing
    min_weight: float = 1 / 32
    max_weight: float = 3.0  # the mean over detail is 1
    # Weight with which mean errors over squares of 4 pixels count once more, after the growth of a run: growth would
    # take the difference for error, and add wide Gaussians instead of correcting fine errors. Notebook, eye.md.
    coarse: float = 1.0
    luma: tuple[float, float, float] = (0.26, 0.66, 0.08)  # about the sum of the eye's cones


@dataclass(frozen=True)
class MovingTargetSettings:
    """Moving targets: for the eye, one that exaggerates detail; for alpha, one that overshoots black and white."""

    every: int = 12  # steps
    max_detail: tuple[float, ...] = (3.0, 1.4)  # in multiples of the source's, by octave, finest first
    detail_window: float = 1.4  # sigma, in samples of the octave; small, so that peaks do not hide their surroundings
    detail_power: float = 1.15  # of the inverse of structural similarity
    detail_rate: float = 0.5  # part of the way per move
    faint_levels: float = 2.0  # of 8 bits: fainter detail is not exaggerated
    overshoot: float = 0.4  # most overshoot allowed, 1 being white
    overshoot_every: int = 2  # steps
    margin: float = 0.02  # overshoot asked for at least
    of_slope: float = 0.3  # additional overshoot, in multiples of the steepest change between neighbouring pixels
    max_slope: float = 0.67


@dataclass(frozen=True)
class TextureSettings:
    """Grain hidden from the fit, and the texture that replaces it."""

    # Grain is hidden gradually between the two values of each pair: not at all below, entirely above.
    grain_left: tuple[float, float] = (0.45, 0.7)  # part of a cell's detail that the fit misses
    grain_levels: tuple[float, float] = (4.0, 7.0)  # strength in levels of 8 bits: faint grain makes no needles
    quantile: float = 0.4  # of a cell's blocks, ordered by energy: the strength of its grain
    floor: float = 0.3  # levels of 8 bits: the spread between two rounded pictures
    excess: float = 8.0  # weight of texture that is too strong in a block, in multiples of that of too weak
    max_levels: float = 3.0  # of 8 bits, which the noise's spread approaches: louder, pebbles and leaves become noise
    share: float = 0.05  # most of a budget of bytes


@dataclass(frozen=True)
class ObjectiveSettings:
    """Settings of the fit's objective."""

    visibility: VisibilitySettings = VisibilitySettings()
    moving: MovingTargetSettings = MovingTargetSettings()
    texture: TextureSettings = TextureSettings()


@dataclass(frozen=True)
class AlphaSettings:
    """Shares of a budget for alpha."""

    max_bytes: float = 0.6  # of a budget of bytes
    max_gaussians: float = 0.25  # of a budget of Gaussians
    # Quantum of alpha, in multiples of that of colours: an error of alpha counts in one channel instead of three, and
    # its fit also pays for errors beyond black and white, which decoding clamps.
    coarser: float = 6.0
    max_error: float = 0.3  # of the error that a PSNR allows
    tries: int = 4  # for a budget in dB
    time: float = 0.3  # of a time limit


@dataclass(frozen=True)
class DeadlineSettings:
    """Planning for a time limit."""

    # Reserved for writing and measuring the file; the shared part is divided by the number of threads.
    reserve_s: float = 0.005
    reserve_s_per_megapixel: float = 0.002
    shared_s_per_megapixel: float = 0.015
    # The search over the file's integers has this part of the limit, or more if these take longer: drawings of the
    # whole picture, its texture, and drawings of the finest level, in gradients with few Gaussians; and trial codings.
    search_share: float = 0.1
    search_gradients: tuple[float, float, float] = (4.0, 7.0, 6.0)
    search_codings: float = 8.0
    gradients_per_step: float = 4.0  # duration of a step, in gradients timed at the start with few Gaussians
    spare_steps: float = 2.0  # steps planned, in multiples of those expected: the limit is what ends them
    # Least time left for a level to be the finest, in gradients on it, and more if its target moves and loses grain.
    finest_gradients: tuple[float, float] = (25.0, 70.0)
    min_round: float = 0.3  # of a round's steps, for which it is begun
    max_when_short: float = 1.3  # DensifySettings.limit if time is too short for the lowest effort
    short: float = 4.0  # in multiples of the time for the pyramid; with less left, growth searches few pixels
    min_part: float = 1 / 3  # least time for the first run, as a part of the time for preparing, even beyond a limit


@dataclass(frozen=True)
class RdSettings:
    """Hyper-parameters of profile rd (ours), in one group per step."""

    profile: ClassVar[str] = "rd"
    effort: Effort = EFFORTS[DEFAULT_EFFORT]
    schedule: ScheduleSettings = ScheduleSettings()
    pyramid: PyramidSettings = PyramidSettings()
    place: PlaceSettings = PlaceSettings()
    fit: FitSettings = FitSettings()
    densify: DensifySettings = DensifySettings()
    prune: PruneSettings = PruneSettings()
    rate: RateSettings = RateSettings()
    refine: RefineSettings = RefineSettings()
    objective: ObjectiveSettings = ObjectiveSettings()
    alpha: AlphaSettings = AlphaSettings()
    deadline: DeadlineSettings = DeadlineSettings()


RD = RdSettings()
