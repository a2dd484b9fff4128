"""Profile rd in the order in which it runs.

1. place      few Gaussians, where the picture has structure                        (fit.py)
2. fit        all Gaussians together, under the price of their bits                 (fit.py)
3. grow       more Gaussians, between the steps of the fit, where they pay          (growth.py)
4. quantise   with the quantum that meets the budget best                           (finish.py, quantiser.py)
5. refine     the integers of each Gaussian, on the picture that the others leave   (native/refine/refine.cpp)
6. write      the bytes of a version 4 file                                         (bitstream/)

Rate control (rate_control.py) steers the quantum through 2 and 3, and sets what 4 has to meet. For the eye, grain that
2 leaves is hidden from it, and becomes texture (texture.py). More effort repeats 2 to 5 in rounds: more Gaussians than
can stay are added and fitted, those that gain least go, and the best file is kept. It also repeats 5: half of the
Gaussians move to what rounding the others has left, and all are refined again. Small pictures of lines, letters or
noise are fitted for other sizes too (ladder.py), and a better file is searched for near the best. Alpha is a picture of
its own, and goes the same way first (alpha.py). A picture of one colour needs none of this.
"""

from __future__ import annotations

import math

import numpy as np
import torch
from numpy.typing import NDArray

from sgmethod.bitstream import container
from sgmethod.bitstream.v4 import StreamV4
from sgmethod.fitting.parameters import Parameters
from sgmethod.fitting.request import Request
from sgmethod.native import native
from sgmethod.profiles import RdSettings, with_size
from sgmethod.rd import alpha
from sgmethod.rd.finish import Finish, Found
from sgmethod.rd.ladder import Ladder, is_small, is_stiff
from sgmethod.rd.quantiser import Coder
from sgmethod.rd.rate_control import RateControl
from sgmethod.rd.runs import Runs, most_steps, place


def encode(request: Request, settings: RdSettings) -> tuple[bytes, int]:
    """The file, and the optimiser steps it took. Raises BudgetError for a budget no file can meet."""
    height, width = request.pixels.shape[:2]
    settings = with_size(settings, width * height)
    with torch.no_grad():
        if request.alpha is None:
            stream, steps = encode_layer(request, settings)
        else:
            stream, steps = alpha.encode(request, settings, encode_layer)
    return write(stream), steps


def encode_layer(request: Request, settings: RdSettings) -> tuple[StreamV4, int]:
    """The stream of one picture without alpha, and the steps it took. What of it alpha shows weighs its errors."""
    control = RateControl.of(request, settings)
    if is_one_colour(request.pixels):
        return Coder.of(request.pixels, control.quantum).stream(Parameters.empty(0)), 0
    ladder = Ladder(request, control)
    small = is_small(request, settings)
    stiff = small and is_stiff(request)
    if stiff and not control.has_goal and math.isinf(request.left_s()):
        return ladder.choice().stream, ladder.steps
    in_all, with_ladder = most_steps(control), most_steps(control) + ladder.most_steps

    def relaxings(rounds: int) -> int:
        return 0 if stiff else max(rounds - 1, 0)  # the ladder makes files of its own

    runs = Runs(place(request, control, request.recorder.preview), request, with_ladder if stiff else in_all)
    runs.first()
    found: list[Found] = []
    for rounds in settings.rounds[:-1]:
        runs.until_round(rounds)
        if not runs.has_time():
            break
        found.append(Finish(runs.fit, request, relaxings(rounds)).found())
    runs.until_round(settings.rounds[-1])
    finish, steps = Finish(runs.fit, request, relaxings(settings.rounds[-1])), runs.steps
    del runs  # what only steps need
    native.release_memory()
    found.append(finish.found())
    # The default goes by what it found first, and so does every further effort: more is never worse.
    first, *further = found
    climbs = small and bool(first.stream.payload) and (stiff or not finish.has_enough(first.stream))
    first_found = [first]
    if climbs:
        first_found = ladder.found(first, with_ladder)
        steps += ladder.steps
        further = further if control.has_goal else []  # for a quality the ladder's choice alone
    parts = [first_found + further[:many] for many in range(len(further) + 1)]
    searched = [Found(finish.searched(part, climbs), finish) for part in parts]
    return finish.best(searched).stream, steps


def is_one_colour(pixels: NDArray[np.uint8]) -> bool:
    """Whether a picture [H, W, 3] is its background, and needs no Gaussian."""
    return bool((pixels == pixels[0, 0]).all())


def write(stream: StreamV4) -> bytes:
    """The file's bytes."""
    return container.serialise(stream)
