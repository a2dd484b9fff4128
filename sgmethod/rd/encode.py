"""Profile rd: how many Gaussians, where, and how fine, decided together by rate and distortion.

Few Gaussians are placed by structure; then, while all are fitted under the price of their bits, Gaussians are added
where they take more error away than their bits are worth and dropped where they do not. One number, the quantum, sets
all steps and the price of a bit. A goal in bytes or decibels steers it.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import torch

from sgmethod.bitstream import container, v3
from sgmethod.bitstream.v3 import CUTOFF
from sgmethod.errors import BudgetError
from sgmethod.fitting.fit import FrameAdam, Parameters, Picture, Plan, Recorder, Task, run
from sgmethod.native import native
from sgmethod.profiles import PAPER, RdSettings
from sgmethod.rd import growth, quantiser
from sgmethod.rd.finish import Finish, Goal
from sgmethod.rd.quantiser import Coder
from sgmethod.scene import FloatArray
from sgmethod.start.placement import place

GREY_TOLERANCE = 0.25 / 255  # channels that differ by less than this everywhere are one
GREY_PROBE = 16  # every so many pixels are looked at first
SMALLEST_FILE = v3.HEADER_BYTES  # without any Gaussian there is no payload
GAUSSIANS_QUALITY = 85.0  # at which a number of Gaussians asked for is fitted
SMALLEST_SIDE = 32  # pixels; smaller pictures are not halved
# First guesses of how many Gaussians there will be: by the bits of one, and by pixels over the quantum.
BIT_GUESS = 30.0
GAUSSIANS_GUESS = 0.0023
PIXELS_OF_FIRST_GUESS = 20  # a Gaussian, at least; growth may put more
GRID_REACH = 1.6  # scales of a Gaussian; two cells are at least 1.68


class RdFit:
    """One fit of one picture."""

    def __init__(self, pixels: FloatArray, goal: Goal, settings: RdSettings, seed: int, recorder: Recorder) -> None:
        """pixels [H, W, 3] in [0, 1]; recorder says when an error will be shown, and so must be exact."""
        self.goal, self.settings, self.recorder = goal, settings, recorder
        self.height, self.width = int(pixels.shape[0]), int(pixels.shape[1])
        background = v3.background_of(pixels)
        grey = len(set(background)) == 1 and _is_grey(pixels[::GREY_PROBE, ::GREY_PROBE]) and _is_grey(pixels)
        self.coder = Coder((self.width, self.height), goal.quantum, background, grey)
        self.picture = Picture((pixels - np.array(background, np.float32) / 255).astype(np.float32), 0.0, CUTOFF)
        self.values = self.picture.target.numel()
        self.pictures = [self.picture]  # each half the size of the one before
        for _ in range(settings.halvings):
            if min(self.pictures[-1].height, self.pictures[-1].width) >= SMALLEST_SIDE:
                self.pictures.append(self.pictures[-1].halved())
        self.finest = self.picture  # that Gaussians are fitted to
        self.mse = 1.0
        self.expected = self._expected_gaussians()
        start = min(max(int(self.expected * settings.start_share), 4), self._most(1.0))
        self.p = self._placed(start, np.random.default_rng(seed))
        self.p.colors = self._smallest(start).solve_colors(self.p.means, self.p.factors, settings.color_solve_steps)
        self.adam = FrameAdam(start, settings)
        self.size = 0
        self.due = sorted([*settings.growth_at, *settings.trim_at])

    def hurry(self, seconds: float) -> None:
        """Fit a smaller picture, most of the time, where so many seconds are too few for the whole one: fewer than all
        steps would take if all were as fast as the first, which is a third of what they take."""
        times = []
        for _ in range(3):  # the first one also touches new memory
            began = self.recorder.clock.seconds()
            self.picture.gradients(self.p)
            times.append(self.recorder.clock.seconds() - began)
        enough, level = self.settings.steps * min(times), 0
        while seconds < enough and level < len(self.pictures) - 1:
            enough, level = enough / 4, level + 1
        self.finest = self.pictures[level]
        # What is narrower falls between the pixels.
        narrowest = self.settings.min_scale_px * self.finest.spacing
        self.adam = FrameAdam(len(self.p.means), replace(self.settings, min_scale_px=narrowest))

    def _placed(self, n: int, rng: np.random.Generator) -> Parameters:
        """n Gaussians where the structure is. They are few, so a smaller picture shows enough of it."""
        picture = self._smallest(n)
        image = picture.target.permute(1, 2, 0).numpy() + np.array(self.coder.background, np.float32) / 255
        placed = Parameters.of(place(np.ascontiguousarray(image), n, PAPER, rng))
        return Parameters(placed.means * picture.spacing, placed.factors * picture.spacing, placed.colors)

    def _expected_gaussians(self) -> int:
        if self.goal.max_gaussians is not None:
            return self.goal.max_gaussians
        pixels = self.height * self.width
        if self.goal.max_bytes is not None:
            return max(min(int(8 * self.goal.max_bytes / BIT_GUESS), pixels), 1)
        return max(min(int(GAUSSIANS_GUESS * pixels / self.goal.quantum), pixels // PIXELS_OF_FIRST_GUESS), 1)

    def _early(self, at: float) -> float:
        """1 while there may be more than was asked for, falling to 0."""
        s = self.settings
        return 1 - min(max((at - s.excess_from) / (s.excess_until - s.excess_from), 0), 1)

    def _excess(self, at: float) -> float:
        """How many times what was asked for there may be: Gaussians, or bytes."""
        return 1 + self.settings.excess * self._early(at)

    def _given_quantum(self, at: float) -> float:
        """The goal's; finer early, where a size or a PSNR would have steered it to."""
        return self.goal.quantum / float(self.settings.finer_early ** self._early(at))

    def _most(self, at: float) -> int:
        most = self.height * self.width
        if self.goal.max_gaussians is not None:
            return min(most, int(self.goal.max_gaussians * self._excess(at)))
        return min(most, int(self.settings.most * self.expected)) if self.goal.max_bytes is not None else most

    def step(self, rate: float, progress: float) -> tuple[float, tuple[int, int]]:
        """One optimiser step, after whatever is due at this part of the schedule."""
        at = None
        while self.due and progress >= self.due[0]:
            at = self.due.pop(0)
        if at is not None:  # of several that one slow step has passed, the last
            self._reconsider(at)
        picture = self._picture_at(progress)
        mse, grad = picture.gradients(self.p)
        if picture is self.picture:
            self.mse = mse
        elif self.recorder.due():
            self.mse = self.recorder.measured(lambda: self.picture.residual(self.p).square().mean().item())
        price = self.settings.rate_weight * quantiser.error_per_bit(self.coder.quantum) / self.values
        quantiser.add_rate_gradient(self.p, grad, self.coder.quantum, price)
        self.adam.step(self.p, grad, rate)
        self._stay_in_grid()
        return self.mse, (len(self.p.means), 8 * self.size)

    def _stay_in_grid(self) -> None:
        """Keep centres where the file can put them: within two cells of the picture, each about as wide as they are."""
        native.keep_near(GRID_REACH, self.width, self.height, self.p.means.numpy(), self.p.factors.numpy())

    def settle(self) -> None:
        """What the end of the schedule does, and a time limit may have skipped."""
        if self.goal.max_gaussians is not None:
            self._drop(self.settings.bits_of_nothing, self.goal.max_gaussians)

    def _picture_at(self, progress: float) -> Picture:
        """The smallest picture that will do; the whole one in the end."""
        if progress >= self.settings.whole_from:
            return self.picture
        if progress >= self.settings.halved_until:
            return self.finest
        return self._smallest(len(self.p.means))

    def _smallest(self, n: int) -> Picture:
        """The smallest picture that tells n Gaussians what they need."""
        enough = self.settings.pixels_per_gaussian * n
        coarser = [p for p in self.pictures if p.spacing > self.finest.spacing and p.height * p.width >= enough]
        return [self.finest, *coarser][-1]

    def _reconsider(self, at: float) -> None:
        """Drop Gaussians, steer the quantum and, while growing, add Gaussians."""
        s = self.settings
        growing = at in s.growth_at
        self._drop(s.bits_of_dropped if at >= s.growth_at[-1] else s.bits_of_nothing, self._most(at))
        self._steer(at, s.steering_exponent if growing else s.trim_exponent)
        if growing:
            self._grow(self._most(at))

    def _drop(self, bits: float, most: int) -> None:
        """Remove Gaussians whose energy is not worth so many bits, and the least of those beyond so many."""
        energies = quantiser.energies(self.p)
        if len(energies) > most:
            energies[torch.argsort(energies, stable=True)[: len(energies) - most]] = 0
        keep = torch.nonzero(energies > bits * quantiser.error_per_bit(self.coder.quantum))[:, 0]
        if len(keep) == len(self.p.means):
            return
        kept = _rows(self.p, keep)
        if self.goal.psnr is not None and self._rounded_psnr(kept) < self.goal.psnr - self.settings.missed_db:
            return  # none would come back once the growth is over
        self.p = kept
        self.adam.select(keep)

    def _grow(self, most: int) -> None:
        n = len(self.p.means)
        # Where no size is given the price alone decides how many; each time the number may double.
        share = self.settings.growth if self.goal.max_bytes is not None else 1.0
        wanted = max(int(share * n), self.expected // len(self.settings.growth_at), 4)
        price = self.settings.rate_weight * quantiser.error_per_bit(self.coder.quantum)
        least = price * self.settings.bits_of_new
        picture = self.finest
        residual = picture.residual(self.p)
        found = growth.candidates(picture.interleaved(residual), min(wanted, most - n), least / picture.spacing**2)
        means, factors = (torch.from_numpy(values) * picture.spacing for values in found)
        if len(means):
            # Neighbours overlap: their colours are solved together, or they would overshoot.
            steps = self.settings.color_solve_steps
            colors = picture.solve_colors(means, factors, steps, residual_of=residual)
            self.p = Parameters(
                torch.cat([self.p.means, means]),
                torch.cat([self.p.factors, factors]),
                torch.cat([self.p.colors, colors]),
            )
            self.adam.extend(len(means))
            self._sort()

    def _sort(self) -> None:
        """By place, along bands as high as a tile: what a tile needs then lies together in memory."""
        means = self.p.means
        order = torch.argsort((means[:, 1] / native.TILE_HEIGHT).floor() * 2 * self.width + means[:, 0], stable=True)
        self.p = _rows(self.p, order)
        self.adam.select(order)

    def _steer(self, at: float, exponent: float) -> None:
        """Move the quantum towards the goal."""
        self.size = len(container.serialise(self.coder.stream(self.p)))
        s = self.settings
        if self.goal.max_bytes is None and self.goal.psnr is None:
            self.coder = self.coder.with_quantum(self._given_quantum(at))
        if at < s.steering_from:
            return
        ratio = 1.0
        if self.goal.max_bytes is not None:
            # More than the whole size from the first: the fine steps that this means serve Gaussians well while they
            # are few; then there are more than can stay, and those that gain least for their bits go.
            ratio = (self.size / (self.goal.max_bytes * self._excess(at))) ** exponent
        elif self.goal.psnr is not None:
            # Early in the growth a larger error than the final one is right.
            missing = max(1 - (at - s.steering_from) / (s.growth_at[-3] - s.steering_from), 0)
            aim = self.goal.psnr - s.early_db * missing
            ratio = 2 ** ((self._rounded_psnr(self.p) - aim) / s.db_per_doubling * exponent)
        if ratio != 1.0:
            limit = s.steering_limit
            self.coder = self.coder.with_quantum(self.coder.quantum * min(max(ratio, 1 / limit), limit))

    def _rounded_psnr(self, p: Parameters) -> float:
        residual = self.picture.residual(self.coder.rounded(p))
        return -10 * math.log10(max(residual.square().mean().item(), 1e-12))


def _is_grey(pixels: FloatArray) -> bool:
    red, green, blue = pixels.transpose(2, 0, 1)
    return all(bool((np.abs(a - b) < GREY_TOLERANCE).all()) for a, b in ((red, green), (green, blue), (red, blue)))


def _rows(p: Parameters, index: torch.Tensor) -> Parameters:
    return Parameters(p.means[index], p.factors[index], p.colors[index])


def encode(task: Task, settings: RdSettings) -> tuple[bytes, int]:
    """The file, and the optimiser steps it took. Raises BudgetError for a budget no file can meet."""
    goal = _goal(task)
    if goal.max_bytes is not None and goal.max_bytes < SMALLEST_FILE:
        raise BudgetError(f"a file of profile rd takes at least {SMALLEST_FILE} bytes, the budget is {goal.max_bytes}")
    with torch.no_grad():
        fit = RdFit(task.pixels, goal, settings, task.seed, task.recorder)
        until = task.until_s()
        if until is not None:
            fit.hurry(settings.fit_share * until - task.recorder.clock.seconds())
        plan = Plan("joint", settings.steps, None if until is None else settings.fit_share * until, patience=1.0)
        done = run(plan, task.recorder, fit.step, settings.final_rate)
        fit.settle()
        stream = Finish(fit.p, fit.coder, fit.picture, goal, settings, task).stream()
        return container.serialise(stream), done


def _goal(task: Task) -> Goal:
    height, width = task.pixels.shape[:2]
    budget = task.budget
    if budget.kind == "quality":
        return Goal(quality_quantum(budget.value))
    if budget.kind == "psnr":
        return Goal(min(0.1 * 2 ** ((34 - budget.value) / 2.5), 0.4), psnr=budget.value)
    if budget.kind == "gaussians":
        return Goal(quality_quantum(GAUSSIANS_QUALITY), max_gaussians=task.gaussians_asked())
    # More bytes than the picture has samples would ask for steps so fine that nothing is left of the method.
    max_bytes = min(budget.max_bytes(width, height) or 0, SMALLEST_FILE + 3 * width * height)
    bpp = max(8 * max_bytes / (width * height), 1e-3)
    return Goal(0.15 * (0.25 / bpp) ** 1.1, max_bytes=max_bytes)


def quality_quantum(quality: float) -> float:
    """The quantum of a quality in 0 .. 100: 16 points halve it, 0 is 3.2. On photographs of 0.4 megapixels 25 comes to
    about 0.05 bpp, 50 to 0.2, 75 to 0.8, 100 to 2.3."""
    return 3.2 * 2 ** (-quality / 16)
