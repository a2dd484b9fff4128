"""Profile rd in the order in which it runs. Each step is a function from one state to the next.

place           few Gaussians, where they gain most                                densify.py
prune           drop Gaussians whose energy is not worth their bits               densify.py
steer           move the quantum, which sets all quantiser steps, to the budget   steer.py
densify         add Gaussians where they gain more than their bits are worth      densify.py
fit             move all of them together, under the price of their bits          fit.py
prune_to_limit  drop Gaussians beyond the number that the budget allows           densify.py
search          quantise and refine with several quanta, keep the best file       search.py

Three values hold what the steps may know: Levels, the picture in its sizes; RateControl, the budget; and Schedule, the
time. The loop of prune, densify and fit knows neither time nor file: it has a pace, 0 to 1, and a guide that steers.

The schedule is a first run and then rounds: as many as the effort has and time allows, and one or two more while a
quality or a PSNR is missed. Within a run, prune to fit repeat in stages. A round adds and fits more Gaussians than can
stay, and drops those that gain least. A picture with alpha is two problems, which alpha.py combines.
"""

from __future__ import annotations

from dataclasses import replace

from sgmethod.backend.kernels import Kernels
from sgmethod.backend.protocol import Backend
from sgmethod.bitstream.v2 import StreamV2
from sgmethod.fitting.deadline import Pace
from sgmethod.rd.densify import densify, place, prune, prune_to_limit
from sgmethod.rd.fit import fit
from sgmethod.rd.levels import Levels
from sgmethod.rd.problem import Problem, Session
from sgmethod.rd.rate_control import Coded, RateControl
from sgmethod.rd.schedule import planned
from sgmethod.rd.search import Search, at_rest
from sgmethod.rd.sparse import pyramid_of
from sgmethod.rd.state import Guide, State, stages
from sgmethod.rd.steer import Steering
from sgmethod.scene import Gaussians
from sgmethod.settings.rd import RdSettings, Times

KERNELS = Kernels()


def encode(
    problem: Problem, settings: RdSettings, rate: RateControl, session: Session, backend: Backend = KERNELS
) -> tuple[StreamV2, int]:
    """Encode a picture within a budget; return the coded picture and the optimiser steps it took."""
    if problem.is_one_colour:
        return problem.stream(Gaussians.empty(0), rate.quantum), 0
    expected = rate.expected_gaussians()
    levels = Levels(problem, pyramid_of(problem, expected, backend), expected, settings.effort, settings.optimiser)
    gaussians = place(levels, rate, is_short=session.deadline.is_short())
    levels, rate, schedule = planned(levels, rate, session.deadline, gaussians)
    state, rounds = levels.begin(gaussians, rate.quantum), schedule.effort.rounds
    files: dict[int, Coded] = {}  # by the number of rounds
    for number, pace, times in schedule.runs():
        state = run(levels, rate, Steering(levels, rate, schedule, session.recorder), state, pace, times)
        if number == rounds[-1] + rate.further_rounds:  # the last run: a search needs memory of its own
            levels, state = at_rest(levels, state)
        if state.is_enough or number in rounds or number > rounds[-1]:
            files[number] = Search(levels, rate, schedule.deadline, session.recorder, state, number).file()
            if rate.is_enough(files[number]):
                break
        if number >= rounds[-1]:
            if not rate.is_missed(files.values()):
                break
            state = replace(state, quantum=rate.quantum_after_miss(state.quantum, files.values()))
    if number not in files:
        files[number] = Search(levels, rate, schedule.deadline, session.recorder, state, number).file()
    return rate.best(files.values()).stream, state.steps


def run(levels: Levels, rate: RateControl, guide: Guide, state: State, pace: Pace, times: Times) -> State:
    """Take the stages of one run of the schedule."""
    for stage in stages(pace, times):
        if stage.is_due:
            state = prune(levels, rate, state, stage)
            state = guide.steer(state, stage)
            if state.is_enough:
                break
            state = densify(levels, rate, state, stage)
        state = fit(levels, state, stage, guide.report)
    return prune_to_limit(levels, rate, state, times)
