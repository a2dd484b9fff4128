"""The ladder: files of a stiff picture at fixed qualities, among which every budget finds the same.

A picture of thin lines, single pixels or noise has a few good files and many bad ones: where its fit ends hangs on the
quantum, on the number of Gaussians and on luck. A budget alone would let a larger one end with a worse file. So such a
picture, if it is small, is also fitted at qualities that no budget moves. What those fits have found, all budgets may
take.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2

from sgmethod.bitstream import container
from sgmethod.bitstream.v4 import StreamV4
from sgmethod.fitting.request import Request
from sgmethod.profiles import RdSettings
from sgmethod.rd.finish import EXACT_DB, NO_LIMIT, Finish
from sgmethod.rd.fit import RdFit
from sgmethod.rd.pyramid import SMALLEST_SIDE
from sgmethod.rd.rate_control import RateControl, quality_quantum
from sgmethod.rd.runs import Runs, place
from sgmethod.trace import shown_to_nobody

DENSE, FEW = 16, 1000  # pixels, or fewer, for each Gaussian, where there are not few of them: then a fit takes long
KEPT = 0.5  # of the variance; of 36 photographs one is below, if it is reduced to 96 pixels


@dataclass(frozen=True)
class Rung:
    """The end of one fit, the coded picture that it gave, and its PSNR in dB."""

    fit: RdFit
    stream: StreamV4
    psnr: float


def is_stiff(request: Request, settings: RdSettings) -> bool:
    """Whether a picture is small and either narrow, or keeps little of its contrast at a quarter of its size, which no
    photograph does."""
    height, width = request.pixels.shape[:2]
    if request.budget.kind == "gaussians" or height * width > settings.ladder_pixels:
        return False
    if min(height, width) < SMALLEST_SIDE:
        return True
    quarter = cv2.resize(request.pixels, (width // 4, height // 4), interpolation=cv2.INTER_AREA)
    return float(quarter.var((0, 1)).sum()) < KEPT * float(request.pixels.var((0, 1)).sum())


class Ladder:
    """The further fits of one encode. most_steps: that they may take; steps: those done."""

    def __init__(self, request: Request, control: RateControl) -> None:
        self.request, self.control = request, control
        coarser = replace(control, max_bytes=None, psnr=None)
        self.controls = [replace(coarser, quantum=quality_quantum(quality)) for quality in control.settings.ladder]
        self.most_steps, self.steps = sum(control.steps() for control in self.controls), 0

    def best(self, own: StreamV4, in_all: int) -> StreamV4:
        """The coded picture that meets the budget best: the encode's own, or one from the ladder. in_all: steps of the
        encode."""
        rungs: list[Rung] = []
        for control in self.controls:
            fit = place(self.request, control, shown_to_nobody)  # a picture that grew sharper is not to begin anew
            runs = Runs(fit, self.request, in_all, in_all - self.most_steps + self.steps)
            if not runs.has_time():
                break
            runs.first()
            self.steps += runs.steps
            finish = Finish(fit, self.request)
            stream = finish.stream()
            rungs.append(Rung(fit, stream, finish.psnr(stream)))
            if self._is_last(rungs):
                break
        if not rungs:
            return own
        for rung in rungs:
            rung.fit.control = self.control
        found = self._within_budget(rungs)
        # Of a quality, the choice is to be the same whatever the quality.
        is_whole = not self.control.has_goal and (len(rungs) == len(self.controls) or _is_dense(rungs[-1]))
        return Finish(rungs[-1].fit, self.request).best(found if is_whole else [own, *found])

    def _within_budget(self, rungs: Sequence[Rung]) -> list[StreamV4]:
        """What the rungs have found, and what becomes of the Gaussians of the best, and of the next finer, within the
        budget."""
        if not self.control.has_goal:
            return [rung.stream for rung in rungs]
        most = NO_LIMIT if self.control.max_bytes is None else self.control.max_bytes
        fitting = [rung for rung in rungs if len(container.serialise(rung.stream)) <= most]
        streams = [rung.stream for rung in fitting]
        finish = Finish(rungs[0].fit, self.request)
        at = streams.index(finish.best(streams)) if fitting else 0
        following = 1 if self.control.max_bytes is None else 2
        return [*streams, *(Finish(rung.fit, self.request).stream() for rung in rungs[at : at + following])]

    def _is_last(self, rungs: Sequence[Rung]) -> bool:
        """Whether the last rung has so many Gaussians that the next would take long, or the one before it is as good or
        as large as the budget says."""
        if _is_dense(rungs[-1]):
            return True
        if not self.control.has_goal or len(rungs) < 2:
            return False
        before = rungs[-2]
        if before.psnr >= min(self.control.psnr or EXACT_DB, EXACT_DB):
            return True
        return self.control.max_bytes is not None and len(before.stream.payload) > self.control.max_bytes


def _is_dense(rung: Rung) -> bool:
    n = len(rung.fit.p.means)
    return n > FEW and DENSE * n > rung.fit.height * rung.fit.width
