"""Fit: move all Gaussians together down the gradient of their error and of the price of their bits."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

from sgmethod.backend.protocol import Descent
from sgmethod.fitting.deadline import cosine
from sgmethod.fitting.level import Level
from sgmethod.rd.levels import Levels
from sgmethod.rd.state import Stage, State

RATE_WEIGHT = 1.7  # price of a bit, in multiples of its theoretical price
SETTLING_WEIGHT = 0.5  # the same from Times.settling_from on
STABLE_LENGTH = 0.5  # factor on the longest step of a fit that came apart (Times.apart)


def fit(levels: Levels, state: State, stage: Stage, report: Callable[[State], None]) -> State:
    """Take the steps of a stage, and take them again with shorter ones the first time that the fit comes apart."""
    began_at = stage.pace.done, stage.pace.progress
    begun = _without_grain(levels, state, stage)
    state = replace(begun, gaussians=begun.gaussians.copy(), moments=begun.moments.copy())
    price = (SETTLING_WEIGHT if stage.at >= stage.times.settling_from else RATE_WEIGHT) * state.bit_price
    moves = 0  # of the target
    errors = defaultdict[tuple[int, float], list[float]](list)  # before each step, by target and weight of coarse ones

    def while_target_rests() -> int:
        return state.target.every - state.steps % state.target.every

    for progress in stage.pace.together(stage.until, while_target_rests):
        level = levels.level_for(state, stage, len(state.gaussians))
        if level.frame == levels.finest.frame and state.target.is_due(state.steps, stage.has_grown):
            missing = levels.finest.missing(state.gaussians, half=state.target.half)
            state = replace(state, target=state.target.moved(missing))
            level = replace(level, target=state.target.now)
            moves += 1
        rates = [cosine(levels.rates.final_rate, at) for at in progress]
        descent = descent_on(levels, level, state.quantum, price, state.step_length)
        coarse = level.visibility.coarse if level.visibility else 0.0
        errors[moves, coarse] += levels.finest.backend.steps(state.gaussians, state.moments, descent, rates)
        state = replace(state, steps=state.steps + len(rates))
        report(state)
    # Whether it comes apart must not depend on how many steps are taken together, which takes their time into account.
    comes_apart = any(after > stage.times.apart * before for one in errors.values() for before, after in pairwise(one))
    if comes_apart and state.step_length > STABLE_LENGTH:
        stage.pace.done, stage.pace.progress = began_at
        # The target that has moved stays: it lies in the memory of the one before, and will move again.
        retaken = state.steps - begun.steps
        again = replace(begun, target=state.target, steps=state.steps, step_length=STABLE_LENGTH, retaken=retaken)
        return fit(levels, again, stage, report)
    return state


def descent_on(levels: Levels, level: Level, quantum: float, price: float, step_length: float = 1.0) -> Descent:
    """Describe what steps on a level minimise.

    price: squared error of the whole picture that a bit costs; step_length: factor on the longest step.
    """
    problem, optimiser = levels.problem, levels.optimiser
    optimiser = replace(optimiser, newton_steps=step_length * optimiser.newton_steps)
    price /= problem.pixels.size
    return Descent(level.frame, level.target, level.visibility, quantum, price, *problem.size, optimiser)


def _without_grain(levels: Levels, state: State, stage: Stage) -> State:
    """Take grain off the target, once the fit misses about as much of it as it will in the end."""
    finest = levels.finest
    is_whole = (finest.frame.width, finest.frame.height) == levels.problem.size
    if not is_whole or stage.at < stage.times.excess_until or state.target.hides:
        return state
    target = state.target.without(levels.problem.objective.grain(finest.missing(state.gaussians)))
    return replace(state, target=target.moved(finest.missing(state.gaussians, half=target.half)))
