"""Profile rd in the order in which it runs. Each step is a function from the plan and the state to the next state.

place           few Gaussians, where they gain most                                densify.py
prune           drop Gaussians whose energy is not worth their bits               densify.py
steer           move the quantum, which sets all quantiser steps, to the budget   steer.py
densify         add Gaussians where they gain more than their bits are worth      densify.py
fit             move all of them together, under the price of their bits          fit.py
prune_to_limit  drop Gaussians beyond the number that the budget allows           densify.py
search          quantise and refine with several quanta, keep the best file       search.py

The schedule is a first run and then rounds: as many as the effort has and time allows, and one or two more while a
quality or a PSNR is missed. Within a run, prune to fit repeat in stages. A round adds and fits more Gaussians than can
stay, and drops those that gain least. A picture with alpha is two problems, which alpha.py combines.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from sgmethod.backend.kernels import Kernels
from sgmethod.backend.protocol import Backend
from sgmethod.bitstream.v2 import StreamV2
from sgmethod.fitting.deadline import Pace
from sgmethod.rd.densify import densify, place, prune, prune_to_limit
from sgmethod.rd.fit import fit
from sgmethod.rd.plan import Plan, Stage, State, stages
from sgmethod.rd.problem import Problem, Session
from sgmethod.rd.rate_control import Coded, RateControl
from sgmethod.rd.search import search
from sgmethod.rd.sparse import pyramid_of
from sgmethod.rd.steer import steer
from sgmethod.scene import Gaussians
from sgmethod.settings.rd import RdSettings, Times

KERNELS = Kernels()


def encode(
    problem: Problem, settings: RdSettings, rate: RateControl, session: Session, backend: Backend = KERNELS
) -> tuple[StreamV2, int]:
    """Encode a picture within a budget; return the coded picture and the optimiser steps it took."""
    if problem.is_one_colour:
        return problem.stream(Gaussians.empty(0), rate.quantum), 0
    plan = Plan(problem, settings, rate, session, pyramid_of(problem, rate.expected_gaussians(), backend))
    gaussians = place(plan)
    plan = plan.in_time(gaussians)
    state, rounds = plan.begin(gaussians), plan.settings.effort.rounds
    files: dict[int, Coded] = {}  # by the number of rounds
    for number, pace in enumerate(plan.session.deadline.runs(plan.lengths)):
        state = run(plan, state, pace, plan.times(number))
        if number == rounds[-1] + rate.further_rounds:  # the last run: a search needs memory of its own
            plan, state = plan.at_rest(state)
        if state.is_enough or number in rounds or number > rounds[-1]:
            files[number] = search(plan, state, number)
            if rate.is_enough(files[number]):
                break
        if number >= rounds[-1]:
            if not rate.is_missed(files.values()):
                break
            state = replace(state, quantum=rate.quantum_after_miss(state.quantum, files.values()))
    if number not in files:
        files[number] = search(plan, state, number)
    return rate.best(files.values()).stream, state.steps


def run(
    plan: Plan, state: State, pace: Pace, times: Times, steer: Callable[[Plan, State, Stage], State] = steer
) -> State:
    """Take the stages of one run of the schedule. steer: sets the price of a bit."""
    for stage in stages(pace, times):
        if stage.is_due:
            state = prune(plan, state, stage)
            state = steer(plan, state, stage)
            if state.is_enough:
                break
            state = densify(plan, state, stage)
        state = fit(plan, state, stage)
    return prune_to_limit(plan, state, times)
