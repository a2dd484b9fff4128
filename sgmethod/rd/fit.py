"""Fit: move all Gaussians together down the gradient of their error and of the price of their bits."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import replace
from functools import partial
from itertools import pairwise

from sgmethod.fitting.deadline import cosine
from sgmethod.rd.plan import Plan, Stage, State

RATE_WEIGHT = 1.7  # price of a bit, in multiples of its theoretical price
SETTLING_WEIGHT = 0.5  # the same from Times.settling_from on
STABLE_LENGTH = 0.5  # factor on the longest step of a fit that came apart (Times.apart)


def fit(plan: Plan, state: State, stage: Stage) -> State:
    """Take the steps of a stage, and take them again with shorter ones the first time that the fit comes apart."""
    began_at = stage.pace.done, stage.pace.progress
    begun = state = _without_grain(plan, state, stage)
    size = len(state.gaussians)
    gaussians, moments, steps = state.gaussians.copy(), state.moments.copy(), state.steps
    weight = SETTLING_WEIGHT if stage.at >= stage.times.settling_from else RATE_WEIGHT
    price = weight * state.bit_price
    moves = 0  # of the target
    errors = defaultdict[tuple[int, float], list[float]](list)  # before each step, by target and weight of coarse ones
    error = partial(plan.error, gaussians, state.quantum)

    def while_target_rests() -> int:
        return state.target.every - steps % state.target.every

    for progress in stage.pace.together(stage.until, while_target_rests):
        level = plan.level_for(state, stage, size)
        if level.frame == plan.finest.frame and state.target.is_due(steps, stage.has_grown):
            missing = plan.finest.missing(gaussians, half=state.target.half)
            state = replace(state, target=state.target.moved(missing))
            level = replace(level, target=state.target.now)
            moves += 1
        rates = [cosine(plan.settings.optimiser.final_rate, at) for at in progress]
        descent = plan.descent(level, state.quantum, price, state.step_length)
        coarse = level.visibility.coarse if level.visibility else 0.0
        errors[moves, coarse] += plan.finest.backend.steps(gaussians, moments, descent, rates)
        steps += len(rates)
        all_steps, tries = plan.all_steps(steps, state.retaken), plan.rate.usual_tries
        plan.session.recorder.report("joint", steps, all_steps, error, size, state.size, tries)
    # Whether it comes apart must not depend on how many steps are taken together, which takes their time into account.
    comes_apart = any(after > stage.times.apart * before for one in errors.values() for before, after in pairwise(one))
    if comes_apart and state.step_length > STABLE_LENGTH:
        stage.pace.done, stage.pace.progress = began_at
        # The target that has moved stays: it lies in the memory of the one before, and will move again.
        retaken = steps - begun.steps
        again = replace(begun, target=state.target, steps=steps, step_length=STABLE_LENGTH, retaken=retaken)
        return fit(plan, again, stage)
    return replace(state, gaussians=gaussians, moments=moments, steps=steps)


def _without_grain(plan: Plan, state: State, stage: Stage) -> State:
    """Take grain off the target, once the fit misses about as much of it as it will in the end."""
    frame = plan.finest.frame
    is_whole = (frame.width, frame.height) == plan.problem.size
    if not is_whole or stage.at < stage.times.excess_until or state.target.hides:
        return state
    target = state.target.without(plan.problem.objective.grain(plan.finest.missing(state.gaussians)))
    return replace(state, target=target.moved(plan.finest.missing(state.gaussians, half=target.half)))
