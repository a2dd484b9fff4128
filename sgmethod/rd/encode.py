"""Profile rd in the order in which it runs.

1. place      few Gaussians, where the picture has structure                        (fit.py)
2. fit        all Gaussians together, under the price of their bits                 (fit.py)
3. grow       more Gaussians, between the steps of the fit, where they pay          (growth.py)
4. quantise   with the quantum that meets the budget best                           (finish.py, quantiser.py)
5. refine     the integers of each Gaussian, on the picture that the others leave   (native/refine/refine.cpp)
6. write      the bytes of a version 4 file                                         (bitstream/)

Rate control (rate_control.py) steers the quantum through 2 and 3, and sets what 4 has to meet.
"""

from __future__ import annotations

import torch

from sgmethod.bitstream import container
from sgmethod.bitstream.v4 import StreamV4
from sgmethod.fitting.request import Request
from sgmethod.fitting.schedule import Schedule
from sgmethod.native import native
from sgmethod.profiles import RdSettings
from sgmethod.rd.finish import Finish
from sgmethod.rd.fit import RdFit
from sgmethod.rd.rate_control import RateControl


def encode(request: Request, settings: RdSettings) -> tuple[bytes, int]:
    """The file, and the optimiser steps it took. Raises BudgetError for a budget no file can meet."""
    control = RateControl.of(request, settings)
    with torch.no_grad():
        fit = place(request, control)
        steps = fit_and_grow(fit, request)
        finish = Finish(fit, request)
        del fit  # what only steps need
        native.release_memory()
        return write(finish.stream()), steps


def place(request: Request, control: RateControl) -> RdFit:
    """Few Gaussians, ready to be fitted."""
    recorder = request.recorder
    return RdFit(request.pixels, control, request.seed, recorder.clock, recorder.preview)


def fit_and_grow(fit: RdFit, request: Request) -> int:
    """Run the schedule, which a time limit or a stop shortens; returns the steps."""
    settings, clock = fit.settings, request.recorder.clock

    def until() -> float | None:
        return request.until_s(settings.fit_share)

    until_s = until()
    if until_s is not None:
        fit.hurry(until_s - clock.seconds())
    schedule = Schedule("joint", fit.control.steps(), settings.final_rate, until, patience=1.0)
    steps = schedule.run(request.recorder, fit.step, fit.decoded_mse)
    fit.settle()
    return steps


def write(stream: StreamV4) -> bytes:
    """The file's bytes."""
    return container.serialise(stream)
