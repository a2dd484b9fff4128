"""Settings of profile rd: ours. Times are parts of a run of the schedule, 0 to 1."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from sgmethod.settings.shared import STRUCTURE, OptimiserSettings, StartSettings

# OpenCV's SLIC needs no 0.3 s of imports; eight photographs of Kodak have 29.479 dB in place of 29.476.
START = replace(STRUCTURE, shared_by_area=False, superpixels="opencv")
# Steps become short by newton_steps, so rates may be high and fall little.
NEWTON_ADAM = OptimiserSettings(
    mean_rate=0.14, factor_rate=0.14, color_rate=0.14, final_rate=0.5, newton_steps=2.0, min_scale_px=0.5
)


@dataclass(frozen=True)
class Times:
    """What is due when, in one run of profile rd's schedule."""

    # Gaussians are added at these times, where each gains more than its bits are worth.
    growth_at: tuple[float, ...] = (0.03, 0.09, 0.15, 0.21, 0.27, 0.33, 0.39, 0.45, 0.55, 0.65)
    # The quantum moves towards the size or the PSNR asked for, at the times of growth and at these.
    trim_at: tuple[float, ...] = (0.72, 0.78, 0.82, 0.86, 0.9, 0.94, 0.97, 0.99)
    steering_from: float = 0.12
    early_db: float = 2.0  # when steering begins, a PSNR this far below the final one is right
    early_until: float = 0.45
    looks_at: tuple[float, ...] = (0.33, 0.65, 0.86)  # to measure looks takes as long as steps

    # Surplus: there may be more than the budget allows at first. It is given up between these times.
    excess: float = 0.5  # a budget of 100 bytes, or Gaussians, allows 150 at first
    finer_early: float = 4.0  # a quantum that the budget gives is divided by this at first
    excess_from: float = 0.45
    excess_until: float = 0.88

    # Until when few pixels do, and from when the last run takes many (PyramidSettings).
    few_until: float = 0.6
    many_from: float = 0.85


# For a first look: few growths, no surplus, and smaller pictures for longer.
QUICK = Times(
    growth_at=(0.03, 0.1, 0.2, 0.32, 0.46, 0.6),
    trim_at=(0.72, 0.8, 0.88, 0.94, 0.98),
    excess=0.0,
    few_until=0.85,
    looks_at=(0.2, 0.32, 0.46, 0.6, 0.88),
)

# Of a round: more Gaussians than can stay are added to a file that is as large as it may be, and those that gain least
# for their bits go.
ROUND = Times(
    growth_at=(0.0, 0.1, 0.2),
    looks_at=(0.5, 0.88),
    trim_at=(0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.88, 0.94, 0.98),
    steering_from=0.0,
    early_db=0.0,
    excess=1.0,
    finer_early=1.35,
    excess_from=0.0,
    excess_until=0.6,
    few_until=0.0,
)


@dataclass(frozen=True)
class Effort:
    """A level of effort of profile rd. Each above the default does all that the one below does, and then goes on."""

    steps: int = 250  # of the first run of the schedule
    times: Times = Times()
    rounds: tuple[int, ...] = (1,)  # after the first run; a file is made after each of these, and the best is kept
    hidden_by: int = 8  # coarser sizes whose gains hide a place of growth, where nothing moves the target: all
    hidden_by_moving: int = 2  # the same where coarse errors move the target, and so are left for long
    refine_sweeps: int = 2  # over all Gaussians
    size_tries: int = 4  # further files with finer quanta, where refining leaves bytes unused


EFFORTS: dict[int, Effort] = {
    1: Effort(75, QUICK, (0,), hidden_by=1, hidden_by_moving=1, refine_sweeps=0, size_tries=0),
    2: Effort(130, rounds=(0,), hidden_by=2, size_tries=2),
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
    """How the length of a run follows from the picture and its Gaussians."""

    dense_steps: float = 2.25  # times the steps where many Gaussians a pixel are expected: they come to rest later
    sparse: float = 0.01  # Gaussians a pixel up to which an effort's steps are enough
    dense: float = 0.035  # and from which there are `dense_steps` times as many
    large: tuple[float, float] = (1e6, 8e6)  # pixels; between them the next two come into force
    large_steps: float = 0.85  # times the steps for a large picture, whose last steps gain least for their time
    large_few_until: float = 0.8  # for a large picture, if later than its times say
    round_steps: float = 0.4  # of the first run's
    round_times: Times = ROUND
    rounds_for_psnr: int = 2  # beyond those of the effort, while a PSNR is missed
    rounds_for_looks: int = 1


@dataclass(frozen=True)
class PyramidSettings:
    """Which size of the picture a part of the fit sees."""

    smallest_side: int = 32  # pixels; smaller pictures are not halved
    # Pixels that a Gaussian needs: while there are few, for most steps, and for the last steps and the file's integers.
    pixels_while_few: float = 20.0
    pixels_per_gaussian: float = 100.0
    pixels_in_the_end: float = 400.0
    # Samples: a narrower Gaussian has another energy at each place between the samples of a smaller picture.
    narrowest: float = 0.75
    contrast_kept: float = 0.7  # of the picture's variance; a smaller picture that keeps less misses what matters


@dataclass(frozen=True)
class PlaceSettings:
    """The first Gaussians, placed by structure."""

    share: float = 0.1  # of the expected number; the others grow
    fewest: int = 4
    color_solve_steps: int = 4  # conjugate-gradient steps
    start: StartSettings = START


@dataclass(frozen=True)
class FitSettings:
    """The optimiser's steps."""

    optimiser: OptimiserSettings = NEWTON_ADAM
    rate_weight: float = 1.7  # price of a bit, in multiples of its theoretical price


@dataclass(frozen=True)
class DensifySettings:
    """Where Gaussians are added."""

    growth: float = 1.0  # new Gaussians at one time are at most this part of those that there are
    fewest: int = 4  # but may be as many
    most: float = 5.0  # times the expected number, under a budget of bytes
    bits_of_new: float = 20.0  # a new Gaussian takes away at least the error that this many bits are worth
    color_solve_steps: int = 4  # conjugate-gradient steps
    saturated: float = 0.001  # new Gaussians, as a part of all; finding fewer ends the search at that price


@dataclass(frozen=True)
class PruneSettings:
    """Which Gaussians are dropped: those whose own energy is worth fewer bits than this."""

    bits_of_nothing: float = 4.3  # while Gaussians are added: what is worth less rounds to nothing in the file
    bits_of_dropped: float = 18.0  # from the last growth on
    missed_db: float = 0.1  # nothing is dropped that would take a PSNR this far below the one asked for


@dataclass(frozen=True)
class RateSettings:
    """How the quantum is steered during the fit, and searched for at its end."""

    bits_per_gaussian: float = 30.0  # first guess
    gaussians_per_pixel: float = 0.0023  # first guess, times the quantum
    fewest_pixels: int = 20  # of a first guess, for each Gaussian; growth may put more
    most_bytes: int = 12  # that a pixel can use, where each has a Gaussian of its own
    gaussians_quality: float = 85.0  # at which a number of Gaussians is fitted
    coarsest_of_aim: float = 0.4  # first quantum
    looks_quantum: tuple[float, float] = (70.0, 0.16)  # looks, and about the quantum that photographs have there
    looks_small: tuple[int, float] = (
        113,
        0.25,
    )  # pixels of a side, and times the quantum: SSIMULACRA 2 is harsher below
    steering_exponent: float = 0.9  # at the times of growth
    trim_exponent: float = 1.0  # later
    steering_limit: float = 1.35  # the quantum's largest change at one time, as a factor
    looks_limit: float = 1.8  # the same where looks are measured, which is seldom
    looks_refined_db: float = 0.35  # that refining adds, at least
    looks_tries: int = 5  # in place of aim_tries
    db_per_doubling: float = 2.5  # PSNR that is lost when the quantum doubles
    least_used: float = 0.985  # of the bytes allowed; if refining leaves less in use, a finer quantum is tried
    quantum_per_size: float = 1.4  # the quantum goes with about this power of the size's inverse
    far_from_size: float = 1.1  # of the bytes allowed; a fit that ends beyond was cut short, and also tries to drop
    aim_tries: int = 7
    slack_db: float = 0.05  # this far above the PSNR asked for is near enough
    least_gain: float = 0.1  # of what a finer quantum should gain; one that gains less is finer than the picture needs
    missed_db: float = 0.1  # where a PSNR is out of reach, one this far below the best seen will do


@dataclass(frozen=True)
class RefineSettings:
    """The integers of the file."""

    weight: float = 0.35  # price of a bit, in multiples of its theoretical price
    # Once for each round after the first, half of the Gaussians move to what rounding the others has left, and all are
    # refined again.
    relaxed_steps: int = 20
    relaxed_rate: float = 0.15
    relaxed_weight: float = 0.6  # price of a bit in these steps, in multiples of its theoretical price
    relaxed_gain: float = 0.005  # of a file's size that this is expected to spare, where a PSNR is asked for
    size_per_db: float = 0.3  # of it, by a PSNR above what is asked for
    most_spared: float = 0.05  # of it


@dataclass(frozen=True)
class VisibilitySettings:
    """How much of an error detail hides (fitting/visibility.py)."""

    shrink: int = 4  # detail is that of a picture reduced by this, which is what SSIMULACRA 2 weighs most
    window: float = 1.5  # sigma of the window, in its samples
    power: float = 0.5  # visibility falls with this power of the variance
    seen_levels: float = 9.0  # of 255: detail that is fainter hides nothing
    least: float = 1 / 32
    most: float = 3.0  # the mean over detail is 1
    luma: tuple[float, float, float] = (0.26, 0.66, 0.08)  # about what the eye's cones add up to


@dataclass(frozen=True)
class MovingTargetSettings:
    """How the target runs ahead of coarse errors and of detail, for the eye; and how far alpha may go beyond black and
    white."""

    every: int = 4  # steps
    shrink: int = 4  # coarse errors are means over squares of this side
    rate: float = 0.15  # of the way to the error of now, at once: from 0.5 on, target and fit swing ever wider
    furthest: float = 0.1  # 1 being white
    most_detail: tuple[float, ...] = (3.0, 1.4)  # times the source's, by octave from half the size on
    detail_window: float = 1.4  # sigma, in samples of the octave: small, so that peaks do not speak for what is beside
    detail_power: float = 1.15  # of the inverse of structural similarity
    detail_rate: float = 0.3  # of the way, at once
    faint_levels: float = 2.0  # of 8 bits: fainter detail is left as it is
    overshoot: float = 0.4
    overshoot_every: int = 2  # steps
    margin: float = 0.02  # beyond black or white, at least
    of_slope: float = 0.3  # further beyond, by the steepest change from pixel to pixel nearby
    most_slope: float = 0.67


@dataclass(frozen=True)
class TextureSettings:
    """Grain that is hidden from the fit, and the texture that stands in for it."""

    grain_hidden: float = 1.0  # of the strength of a cell's grain: detail that is no stronger is hidden as a whole
    grain_left: tuple[float, float] = (0.6, 0.85)  # of a cell's detail, by the fit: none is hidden below, all above
    grain_levels: tuple[float, float] = (4.0, 7.0)  # of 8 bits: the same by its strength; faint grain makes no needles
    gain: tuple[float, float] = (0.62, 0.42)  # by octave, of a spread of `middle` that is left
    middle: float = 3.0  # levels of 8 bits
    power: float = 0.6  # of other spreads, with which strengths go: much grain where much is left looks broken
    most: tuple[float, float] = (0.7, 0.97)  # by octave, of the spread that is left
    floor: float = 0.3  # levels of 8 bits; rounding two pictures leaves that much between them
    quantile: float = 0.4  # of the blocks of a cell, by the energy that is left in them
    share: float = 0.05  # of a budget of bytes, at most


@dataclass(frozen=True)
class ObjectiveSettings:
    """What an error counts."""

    visibility: VisibilitySettings = VisibilitySettings()
    moving: MovingTargetSettings = MovingTargetSettings()
    texture: TextureSettings = TextureSettings()


@dataclass(frozen=True)
class AlphaSettings:
    """How a budget is shared between alpha and colours."""

    most_bytes: float = 0.6  # of a budget of bytes
    most_gaussians: float = 0.25  # of a budget of Gaussians
    # The quantum of alpha, in multiples of that of colours: an error of alpha counts once and not in three channels,
    # and its fit pays for errors beyond black and white, which decoding clamps.
    coarser: float = 6.0
    most_error: float = 0.3  # of the error that a PSNR allows
    tries: int = 4  # at a PSNR
    time: float = 0.3  # of a time limit


@dataclass(frozen=True)
class DeadlineSettings:
    """How a time limit and a stop are planned for."""

    # Kept back of a limit, for writing and measuring the file; the shared part is spread over all threads.
    reserve_s: float = 0.02
    reserve_s_per_megapixel: float = 0.1
    shared_s_per_megapixel: float = 0.1
    winding_down: float = 0.25  # an encode that is stopped ends within this part of the time so far
    most_winding_down_s: float = 3.0  # and within this
    fit_share: float = 0.9  # of the limit; the rest is for the end
    gradients_per_step: float = 4.0  # the time of a step, in gradients timed at the start, when Gaussians are few
    most_hurried: float = 1.3  # DensifySettings.most where there is no time for the lowest effort
    short: float = 4.0  # times what the pyramid took: where less is left, places are looked for on few pixels
    least_part: float = 1 / 3  # of the time that preparing took, for the first run, however late that is


@dataclass(frozen=True)
class RdSettings:
    """Hyper-parameters of profile rd: ours. One group for each step, each with the numbers of that step alone."""

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


def sized(settings: RdSettings, pixels: int) -> RdSettings:
    """The settings for a picture of this size: a large one takes fewer steps, and smaller pictures for longer."""
    s, effort = settings.schedule, settings.effort
    small, large = s.large
    share = min(max(math.log(pixels / small) / math.log(large / small), 0.0), 1.0)
    later = max(s.large_few_until - effort.times.few_until, 0.0)
    times = replace(effort.times, few_until=effort.times.few_until + share * later)
    steps = round(effort.steps * (1 - share * (1 - s.large_steps)))
    return replace(settings, effort=replace(effort, steps=steps, times=times))


def hurried(settings: RdSettings, pixels: int, steps: float) -> RdSettings:
    """Settings that fit into `steps`, for settings that are sized(): the effort as it is if it does, else the highest
    lower effort that does, else the lowest with fewer Gaussians."""
    lower = [sized(replace(settings, effort=one), pixels) for one in reversed(EFFORTS.values()) if one.rounds == (0,)]
    choices = [settings, *(one for one in lower if one.effort.steps < settings.effort.steps)]
    few = replace(choices[-1].densify, most=settings.deadline.most_hurried)
    return next((one for one in choices if one.effort.steps <= steps), replace(choices[-1], densify=few))
