"""The ladder: files of a stiff picture at fixed sizes, among which every budget finds the same.

A picture of thin lines, single pixels or noise has a few good files and many bad ones: where its fit ends hangs on the
quantum, on the number of Gaussians and on luck. A budget alone would let a larger one end with a worse file. So such a
picture, if it is small, is also fitted for sizes that no budget moves. What those fits have found, all budgets may
take. A budget of a size or a PSNR also goes on from the best of them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2

from sgmethod.bitstream import container
from sgmethod.fitting.request import Request
from sgmethod.profiles import RdSettings
from sgmethod.rd import quantiser
from sgmethod.rd.finish import EXACT_DB, ROUNDED_DB, Finish, Found
from sgmethod.rd.fit import RdFit
from sgmethod.rd.pyramid import SMALLEST_SIDE
from sgmethod.rd.rate_control import SMALLEST_FILE, RateControl
from sgmethod.rd.runs import Runs, place, steps_of_round
from sgmethod.trace import shown_to_nobody

DENSE, FEW = 8, 1000  # pixels, or fewer, for each Gaussian, where there are not few of them: then a fit takes long
ABOVE = 1.1  # the rungs end with the first that has more than so many times the budget's bytes
FURTHER = 3  # rounds, at most, with which a budget goes on from a rung
LAST = 4  # rungs from which a tiny file goes on
NEAR_DB = 12.0  # a budget of PSNR goes on from a rung that is at most so far below it
LEAST_PART = 1 / 8  # a budget of bytes goes on from a rung that has at least so much of them
DB_OF_TWICE = 6.0  # what such a rung promises for twice its bytes: a bit more for each number
LITTLE_DB = 0.1  # a promise that is not worth the time
KEPT = 0.5  # of the variance; of 36 photographs one is below, if it is reduced to 96 pixels


@dataclass(frozen=True)
class Rung:
    """The end of one fit, the coded picture that it gave, its bytes as a file, its PSNR in dB, and its squared error as
    Finish.error() has it."""

    fit: RdFit
    found: Found
    size: int
    psnr: float
    error: float


def is_small(request: Request, settings: RdSettings) -> bool:
    """Whether a picture may be fitted many times, and its budget says more than a number of Gaussians."""
    height, width = request.pixels.shape[:2]
    return request.budget.kind != "gaussians" and height * width <= settings.ladder_pixels


def is_stiff(request: Request) -> bool:
    """Whether a picture is narrow, or keeps little of its contrast at a quarter of its size. No photograph does."""
    height, width = request.pixels.shape[:2]
    if min(height, width) < SMALLEST_SIDE:
        return True
    quarter = cv2.resize(request.pixels, (width // 4, height // 4), interpolation=cv2.INTER_AREA)
    return float(quarter.var((0, 1)).sum()) < KEPT * float(request.pixels.var((0, 1)).sum())


class Ladder:
    """The further fits of one encode. most_steps: that they may take; steps: those done."""

    def __init__(self, request: Request, control: RateControl) -> None:
        self.request, self.control = request, control
        self.controls = [control.for_size(size) for size in self._sizes()]
        of_rungs = sum(control.steps() + steps_of_round(control) for control in self.controls)
        self.most_steps = of_rungs + control.steps() + LAST * FURTHER * steps_of_round(control)
        self.steps = 0

    def choice(self) -> Found:
        """For a quality, without a fit of its own, which would count for nothing. Where the encode is to end before the
        last rung, there is one in the time that is left."""
        rungs, is_whole = self._climbed(self.most_steps, alone=True)
        if not is_whole:
            runs = self._runs(place(self.request, self.control, shown_to_nobody), self.most_steps)
            runs.first()
            rungs.append(self._rung(runs))
        return self._chosen(rungs)

    def found(self, own: Found, in_all: int) -> list[Found]:
        """The encode's own coded picture, and those from the ladder; for a quality the ladder's choice alone.
        in_all: steps of the encode."""
        rungs, is_whole = self._climbed(in_all)
        if not rungs:
            return [own]
        if not self.control.has_goal and is_whole:
            return [self._chosen(rungs)]
        judge = Finish(rungs[-1].fit, self.request)
        found = [own, *self._within_budget(rungs, judge)]
        for rung in self._worth_more(rungs, judge.best(found), judge):
            found += self._further(rung, judge, in_all)
        return found

    def _chosen(self, rungs: list[Rung]) -> Found:
        """For a quality: the best for its bytes of all rungs and of the background alone, which are the same whatever
        the quality."""
        judge = Finish(rungs[-1].fit, self.request)
        return judge.best([Found(judge.background(), judge), *(rung.found for rung in rungs)])

    def _climbed(self, in_all: int, alone: bool = False) -> tuple[list[Rung], bool]:
        """The rungs for which there is time, ready to be judged by the budget, and whether those are all. alone: no fit
        went before, so that their files are the encode's previews, and what time there is after a stop is for one."""
        rungs: list[Rung] = []
        is_whole = True
        preview = self.request.recorder.preview if alone else shown_to_nobody  # which would begin anew
        for control in self.controls:
            runs = self._runs(place(self.request, control, shown_to_nobody), in_all)
            if not runs.has_time() or (alone and math.isfinite(self.request.left_s())):
                is_whole = False
                break
            runs.first()
            runs.until_round(1)
            rungs.append(self._rung(runs))
            preview(container.serialise(rungs[-1].found.stream))
            if self._is_last(rungs):
                break
        for rung in rungs:
            rung.fit.control = self.control
        return rungs, is_whole

    def _further(self, rung: Rung, judge: Finish, in_all: int) -> list[Found]:
        """What the fit of a rung comes to if it goes on, within the budget's bytes, or within those that the rung
        promises for the PSNR asked for."""
        found: list[Found] = []
        runs = self._runs(rung.fit, in_all)
        for number in range(1, FURTHER + 1):
            if not runs.has_time():
                break
            if self.control.psnr is not None:
                size = min(max(self._promised(rung), rung.size / 2), 2 * rung.size)
                rung.fit.control = self.control.for_size(max(round(size), SMALLEST_FILE))
            runs.until_round(number)
            rung = self._rung(runs)
            found.append(rung.found)
            rung.fit.control = self.control
            if judge.has_enough(rung.found.stream):
                break
        if self.control.psnr is not None and found:
            found.append(Finish(rung.fit, self.request).found())
        return found

    def _sizes(self) -> list[int]:
        """Bytes of the rungs, up to the first that is larger than the budget, or that no file can use."""
        most = self.control.most_bytes() if self.control.max_bytes is None else ABOVE * self.control.max_bytes
        sizes = self.control.settings.ladder
        return [size for size, before in zip(sizes, (0, *sizes), strict=False) if before < most]

    def _runs(self, fit: RdFit, in_all: int) -> Runs:
        return Runs(fit, self.request, in_all, in_all - self.most_steps + self.steps)

    def _rung(self, runs: Runs) -> Rung:
        self.steps, runs.before, runs.steps = self.steps + runs.steps, runs.before + runs.steps, 0
        finish = Finish(runs.fit, self.request)
        found = finish.found()
        size = len(container.serialise(found.stream))
        return Rung(runs.fit, found, size, finish.psnr(found.stream), finish.error(found.stream))

    def _within_budget(self, rungs: list[Rung], judge: Finish) -> list[Found]:
        """What the rungs have found, and what becomes of the Gaussians of the best, and of the next finer, within the
        budget."""
        most = self.control.max_bytes
        found = [rung.found for rung in self._fitting(rungs)]
        if not self.control.has_goal:
            return found
        at = found.index(judge.best(found)) if found else 0
        for rung in rungs[at : at + (1 if most is None else 2)]:
            found.append(Finish(rung.fit, self.request).found())
        return found

    def _worth_more(self, rungs: list[Rung], best: Found, judge: Finish) -> list[Rung]:
        """The rungs from which further rounds may come to more than the best that was found: one that is good for its
        bytes, where the budget has more of them; one below the PSNR asked for; of a tiny file several, which take
        little time and of which each may be lucky."""
        most, db = self.control.max_bytes, judge.psnr(best.stream)
        if most is None:
            if len(best.stream.payload) <= self.control.settings.tiny_bytes:
                return rungs[-LAST:]
            aim = self.control.psnr or math.inf
            near = [rung for rung in rungs if aim - NEAR_DB <= rung.psnr < aim]
            return sorted(near, key=self._promised)[:1]
        if db >= ROUNDED_DB:
            return []
        near = [rung for rung in self._fitting(rungs) if rung.size >= LEAST_PART * most]
        promising = sorted(near, key=self._promised)[-1:]
        return [rung for rung in promising if self._promised(rung) > db + LITTLE_DB]

    def _promised(self, rung: Rung) -> float:
        """The bytes for the PSNR asked for, or the dB for the bytes, if a rung's fit goes on."""
        if self.control.max_bytes is not None:
            return rung.psnr + DB_OF_TWICE * math.log2(self.control.max_bytes / rung.size)
        return rung.size * 2 ** (((self.control.psnr or EXACT_DB) - rung.psnr) / DB_OF_TWICE)

    def _fitting(self, rungs: list[Rung]) -> list[Rung]:
        """Those within the budget's bytes."""
        most = self.control.max_bytes
        return [rung for rung in rungs if most is None or rung.size <= most]

    def _is_last(self, rungs: list[Rung]) -> bool:
        """Whether the last rung has so many Gaussians that the next would take long, or the budget asks for no more, or
        the next would cost more than all that is left of the error."""
        last = rungs[-1]
        n = len(last.fit.p.means)
        if last.psnr >= min(self.control.psnr or EXACT_DB, EXACT_DB):
            return True
        if n > FEW and DENSE * n > last.fit.height * last.fit.width:
            return True
        if self.control.has_goal:
            return False
        price = 8 * quantiser.error_per_bit(self.control.quantum)
        return price * last.size > min(rung.error + price * rung.size for rung in rungs)
