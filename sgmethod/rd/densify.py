"""Place, prune and densify: begin with few Gaussians, drop those that are not worth their bits, add those that are."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from sgmethod.backend.protocol import TILE_HEIGHT, release_memory
from sgmethod.fitting.level import PIXELS_WHILE_FEW, Level
from sgmethod.fitting.matching_pursuit import candidates
from sgmethod.rd.fit import RATE_WEIGHT
from sgmethod.rd.levels import MANY_VALUES, Levels
from sgmethod.rd.rate_control import RateControl
from sgmethod.rd.state import Stage, State
from sgmethod.scene import Gaussians
from sgmethod.settings.rd import Times

# Searches for the first Gaussians, each on what is left. One finds a fifth to half of them, and loses up to 8 dB where
# bytes are many and time is short; sixteen change nothing.
SEARCHES = 8
SHARE_PLACED = 0.1  # first Gaussians, as a part of the expected number; the others are added by growth
FEWEST = 4  # first Gaussians, and new ones allowed regardless of `GROWTH`
GROWTH = 1.0  # most new Gaussians at one time, as a part of the existing ones
BITS_OF_NEW = 20.0  # a new Gaussian must reduce the error by what this many bits are worth
COLOR_SOLVE_STEPS = 4  # of conjugate gradients
SATURATED = 0.001  # new Gaussians, as a part of all; finding fewer ends the search at that price
# A Gaussian is dropped if its own energy is worth fewer bits: during growth, if it rounds to nothing in the file.
WORTHLESS_BITS = 4.3
BITS_OF_DROPPED = 21.0  # from the last growth on


def place(levels: Levels, rate: RateControl, *, is_short: bool = False) -> Gaussians:
    """Place a part of the expected Gaussians, where they gain most.

    As they are few, a small picture shows enough; if time is short, a smaller one has to do. On an empty picture, wide
    gains hide most places, so a search finds a few Gaussians at a time.
    """
    share = max(int(levels.gaussians * SHARE_PLACED), FEWEST)
    n = min(share, rate.allowed_gaussians(levels.effort.times, 1.0))
    level = levels.pyramid.coarsest(PIXELS_WHILE_FEW * (n // 4 if is_short else n))
    placed = Gaussians.empty(0)
    for _ in range(SEARCHES):
        new = _found(levels, placed, level, n - len(placed), 0.0)
        placed = placed.with_more(new)
        if len(placed) >= n or len(new) == 0:
            break
    return placed


def prune(levels: Levels, rate: RateControl, state: State, stage: Stage) -> State:
    """Drop Gaussians whose energy is not worth their bits, and the faintest of those beyond the budget's limit."""
    bits = BITS_OF_DROPPED if stage.at >= stage.times.growth_at[-1] else WORTHLESS_BITS
    return strongest(levels, rate, state, bits, rate.allowed_gaussians(stage.times, stage.at))


def prune_to_limit(levels: Levels, rate: RateControl, state: State, times: Times) -> State:
    """Drop Gaussians beyond the budget's limit at the end of a run: a time limit may have skipped pruning."""
    return strongest(levels, rate, state, WORTHLESS_BITS, rate.allowed_gaussians(times, 1.0))


def strongest(levels: Levels, rate: RateControl, state: State, bits: float, limit: int) -> State:
    """Keep at most `limit` Gaussians, each with an energy that is worth more than this many bits."""
    energies = levels.problem.objective.energies(state.gaussians)
    if len(energies) > limit:
        energies[np.argsort(energies, kind="stable")[: len(energies) - limit]] = 0
    keep = np.flatnonzero(energies > bits * state.bit_price)
    if len(keep) == len(energies):
        return state
    kept = state.rows(keep)
    psnr = partial(levels.psnr, kept.gaussians, kept.quantum)
    return kept if rate.allows(psnr) else state


def densify(levels: Levels, rate: RateControl, state: State, stage: Stage) -> State:
    """Add Gaussians that gain more than their bits are worth.

    They are searched for on a level of the pyramid that is fine enough for all Gaussians together.
    """
    price = RATE_WEIGHT * state.bit_price
    is_first = stage.at == stage.times.growth_at[0]
    if not stage.grows or (price >= state.saturated_price and not is_first):
        return state  # nothing was worth this price, and the error has not grown since
    n = len(state.gaussians)
    at_once = max(int(GROWTH * n), levels.gaussians // len(stage.times.growth_at), FEWEST)
    limit = min(at_once, rate.allowed_gaussians(stage.times, stage.at) - n)
    level = levels.level_for(state, stage, n + limit)
    min_gain = price * BITS_OF_NEW / level.frame.spacing**2
    if level.values > MANY_VALUES:
        release_memory()  # of the steps
    new = _found(levels, state.gaussians, level, limit, min_gain)
    saturated = price if len(new) < min(limit, SATURATED * n) else state.saturated_price
    if len(new) == 0:
        return replace(state, saturated_price=saturated)
    if level.values > MANY_VALUES:
        release_memory()
    gaussians = state.gaussians.with_more(new)
    stage.pace.grown(len(gaussians) / max(n, 1))
    size = state.size * len(gaussians) // max(n, 1)
    moments = state.moments.with_more(len(new))
    grown = replace(state, gaussians=gaussians, moments=moments, size=size, saturated_price=saturated)
    x, y = gaussians.means.T
    width = levels.problem.size[0]
    bands = np.floor(y / TILE_HEIGHT) * 2 * width + x  # Gaussians of a tile then lie together in memory
    return grown.rows(np.argsort(bands, kind="stable"))


def _found(levels: Levels, others: Gaussians, level: Level, limit: int, min_gain: float) -> Gaussians:
    """Find round Gaussians that gain most on what others leave of a level.

    Their colours are solved together: neighbours overlap, and would overshoot.
    """
    suppression_levels = levels.problem.objective.suppression_levels(levels.effort)
    size = level.frame.height, level.frame.width
    means, factors = candidates(level.residual(others), size, limit, min_gain, suppression_levels)
    if len(means) == 0:
        return Gaussians.empty(0)
    return level.solve_colors(level.shapes(means, factors), COLOR_SOLVE_STEPS, others)
