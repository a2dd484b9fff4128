"""Profile rd in the order in which it runs. Each step is a function from the plan and the state to the next state.

place           few Gaussians, where the picture has structure                    place.py
prune           drop Gaussians whose energy is not worth their bits               densify.py
steer           move the quantum, which sets all quantiser steps, to the budget   steer.py
densify         add Gaussians where they gain more than their bits are worth      densify.py
fit             move all of them together, under the price of their bits          fit.py
prune_to_limit  drop Gaussians beyond the number that the budget allows           densify.py
search          quantise and refine with several quanta, keep the best file       search.py

The schedule is a first run and then rounds: as many as the effort has and time allows, and one or two more while a
quality or a PSNR is missed. Within a run, prune to fit repeat in stages. A round adds and fits more Gaussians than can
stay, and drops those that gain least. Alpha takes two requests, which alpha.py combines.
"""

from __future__ import annotations

from dataclasses import replace

from sgmethod.bitstream.v2 import StreamV2
from sgmethod.rd.densify import densify, prune, prune_to_limit
from sgmethod.rd.fit import fit
from sgmethod.rd.place import place
from sgmethod.rd.plan import Plan, stages
from sgmethod.rd.rate_control import Coded
from sgmethod.rd.request import Request
from sgmethod.rd.search import search
from sgmethod.rd.sparse import on_islands
from sgmethod.rd.steer import retarget_after_miss, steer
from sgmethod.scene import Gaussians


def encode(request: Request) -> tuple[StreamV2, int]:
    """Encode a request; return the coded picture and the optimiser steps it took."""
    if request.is_one_colour:
        return request.stream(Gaussians.empty(0), request.rate.quantum), 0
    request, pyramid = on_islands(request)
    gaussians = place(request, pyramid)
    plan = Plan.from_request(request, pyramid, gaussians)
    request, state = plan.request, plan.begin(gaussians)
    rate, rounds = request.rate, plan.settings.effort.rounds
    files: dict[int, Coded] = {}  # by the number of rounds
    for number, pace in enumerate(request.deadline.runs(plan.lengths)):
        for stage in stages(pace, plan.times(number)):
            if stage.is_due:
                state = prune(plan, state, stage)
                state = steer(plan, state, stage)
                if state.is_enough:
                    break
                state = densify(plan, state, stage)
            state = fit(plan, state, stage)
        state = prune_to_limit(plan, state, plan.times(number))
        if number == rounds[-1] + rate.further_rounds:  # the last that may follow: a search needs memory of its own
            state = replace(state, target=state.target.at_rest())
        if state.is_enough or number in rounds or number > rounds[-1]:
            files[number] = search(plan, state, number)
            if rate.is_enough(files[number]):
                break
        if number >= rounds[-1]:
            if not rate.is_missed(files.values()):
                break
            state = retarget_after_miss(plan, state, files.values())
    if number not in files:
        files[number] = search(plan, state, number)
    return rate.best(files.values()).stream, state.steps
