"""Levels: the sizes of the picture that Gaussians are fitted to, and how far they are from it."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

from sgmethod.backend.protocol import Moments, Visibility
from sgmethod.fitting.level import PIXELS_PER_GAUSSIAN, PIXELS_WHILE_FEW, Level, Pyramid
from sgmethod.rd.problem import Problem
from sgmethod.rd.state import Stage, State
from sgmethod.scene import Gaussians
from sgmethod.settings.rd import Effort
from sgmethod.settings.shared import OptimiserSettings

MANY_VALUES = 1 << 23  # samples of a level; work on a smaller one leaves little memory behind
# Samples: the energy of a narrower Gaussian depends on its position between the samples of a smaller picture.
NARROWEST = 0.75


@dataclass(frozen=True)
class Levels:
    """The picture in the sizes that its Gaussians can show. gaussians: the expected number."""

    problem: Problem
    pyramid: Pyramid
    gaussians: int
    effort: Effort
    rates: OptimiserSettings

    @property
    def finest(self) -> Level:
        """The picture at the size that the file can show."""
        return self.pyramid.finest

    @cached_property
    def shown(self) -> Visibility | None:
        """Share of the finest level that alpha shows."""
        shown = self.problem.objective.shown
        for _ in range(self.finest.frame.spacing.bit_length() - 1):
            shown = shown and shown.half
        return shown

    @property
    def usual(self) -> Level:
        """The level of most steps."""
        return self.pyramid.coarsest(PIXELS_PER_GAUSSIAN * self.gaussians)

    @property
    def optimiser(self) -> OptimiserSettings:
        """The optimiser's settings, with a scale below which a Gaussian falls between pixels of the finest level."""
        spacing, least = self.finest.frame.spacing, self.rates.min_scale_px
        return self.rates if spacing == 1 else replace(self.rates, min_scale_px=spacing * max(NARROWEST, least))

    def begin(self, gaussians: Gaussians, quantum: float) -> State:
        """Return the state before the first step."""
        finest, background = self.finest, self.problem.background[0]
        target = self.problem.objective.moving_target(finest.target, finest.frame.spacing, background)
        return State(gaussians, Moments.none(len(gaussians)), quantum, target)

    def level_for(self, state: State, stage: Stage, gaussians: int) -> Level:
        """Choose the level that this many Gaussians are fitted to: the coarsest that will do, in the end the finest."""
        progress, times = stage.pace.progress, stage.times
        if progress >= times.many_from:
            level = self.finest
        elif progress >= times.few_until:
            level = self.pyramid.coarsest(PIXELS_PER_GAUSSIAN * max(gaussians, self.gaussians))
        else:
            level = self.pyramid.coarsest(PIXELS_WHILE_FEW * gaussians)
        if stage.has_grown:
            level = self.problem.objective.with_coarse(level)
        return replace(level, target=state.target.now) if level.frame == self.finest.frame else level

    def error(self, gaussians: Gaussians, quantum: float | None = None) -> float:
        """Mean squared error on the finest level; given a quantum, of Gaussians as they would decode."""
        backend, level = self.finest.backend, self.finest
        if quantum is not None:
            gaussians = backend.rounded(gaussians, self.problem.coding(quantum))
        return backend.error(gaussians, level.frame, level.target, self.shown)

    def psnr(self, gaussians: Gaussians, quantum: float | None = None) -> float:
        """PSNR on the finest level, in dB, as error() measures it."""
        return -10 * math.log10(max(self.error(gaussians, quantum), 1e-12))
