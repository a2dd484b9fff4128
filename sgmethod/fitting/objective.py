"""The objective of an encode: errors weighted for the eye or for PSNR, under alpha, with texture."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from sgmethod.backend.protocol import COARSE_SIDE, VISIBLE, Target, Visibility
from sgmethod.bitstream.stream import Stream
from sgmethod.bitstream.texture import Codes
from sgmethod.decoder import draw_whole
from sgmethod.fitting import texture, visibility
from sgmethod.fitting.bands import Rows
from sgmethod.fitting.level import Histogram, Level
from sgmethod.fitting.moving_target import ExaggeratedTarget, FitTarget, OvershootingTarget
from sgmethod.fitting.visibility import VisibleShare
from sgmethod.metrics import psnr, ssimulacra2
from sgmethod.scene import FloatArray, Gaussians, Pixels
from sgmethod.settings.rd import Effort
from sgmethod.settings.shared import Tune

GREY = 128.0
# Weight with which mean errors over squares of 4 pixels count once more, after the growth of a run: growth would
# take the difference for error, and add wide Gaussians instead of correcting fine errors. Notebook, eye.md.
COARSE = 1.0


@dataclass(frozen=True)
class Objective:
    """The error that one picture's encode minimises.

    pixels: [H, W, 3]; tune: as in encode(), and "psnr" for alpha planes, previews and torch.fit(); is_alpha: the
    picture is an alpha plane, which may overshoot; shown: the weights due to alpha alone; visibility: weights of the
    pixels' errors in the fit, None if all are equal; visible_share: of each Gaussian's energy by these.
    """

    pixels: Pixels
    tune: Tune = "psnr"
    is_alpha: bool = False
    shown: Visibility | None = None
    visibility: Visibility | None = None
    visible_share: VisibleShare | None = None

    @classmethod
    def from_pixels(cls, pixels: Pixels, tune: Tune, alpha: Pixels | None = None) -> Objective:
        """Objective for colours [H, W, 3], under alpha [H, W] unless they are opaque."""
        shown = None if alpha is None else visibility.of_alpha(alpha)
        visible = shown if tune == "psnr" else visibility.of_detail(pixels, shown)
        share = None if visible is None else VisibleShare(visible)
        return cls(pixels, tune, False, shown, visible, share)

    @classmethod
    def from_alpha(cls, alpha: Pixels) -> Objective:
        """Objective for an alpha plane [H, W]."""
        return cls(np.repeat(alpha[..., None], 3, axis=2), is_alpha=True)

    @cached_property
    def histogram(self) -> Histogram:
        """Statistics of the picture's levels."""
        return Histogram(self.pixels)

    @property
    def for_eye(self) -> bool:
        """Whether errors are weighted by how visible they are."""
        return self.tune != "psnr"

    @property
    def replaces_grain(self) -> bool:
        """Whether texture may replace grain: not in strips thinner than the blocks in which it is measured."""
        return self.tune == "visual" and min(self.pixels.shape[:2]) >= texture.BLOCK

    def under(self, pixels: Pixels, alpha: Pixels) -> Objective:
        """Return the same objective for colours [H, W, 3] under alpha [H, W]."""
        return Objective.from_pixels(pixels, self.tune, alpha)

    def moving_target(self, target: Target, spacing: int, background: int) -> FitTarget:
        """Build the fit's moving target. spacing: of its samples, in pixels; background: level of an alpha plane's."""
        if self.is_alpha:
            return OvershootingTarget.from_target(target, background)
        if self.for_eye and min(self.pixels.shape[:2]) >= texture.BLOCK and spacing < COARSE_SIDE:
            return ExaggeratedTarget.from_target(target, hides=not self.replaces_grain)
        return FitTarget(target, target)

    def suppression_levels(self, effort: Effort) -> int:
        """Coarser sizes whose gains can hide a place of growth: few for the eye."""
        return effort.suppression_levels_for_eye if self.for_eye else effort.suppression_levels

    def with_coarse(self, level: Level) -> Level:
        """Return a level on which coarse errors count once more if they are visible."""
        return level if level.visibility is None else replace(level, visibility=self._with_coarse(level.visibility))

    def _with_coarse(self, visible: Visibility) -> Visibility:
        return replace(visible, coarse=COARSE) if self.for_eye else visible

    def energies(self, gaussians: Gaussians) -> FloatArray:
        """Weighted squared error [N] that dropping each Gaussian alone would add."""
        l1, l3 = gaussians.factors[:, 0], gaussians.factors[:, 2]
        energies = np.float32(np.pi) * l1 * l3 * np.square(gaussians.colors).sum(1)
        return np.asarray(
            energies if self.visible_share is None else energies * self.visible_share.look_up(gaussians), np.float32
        )

    def grain(self, residual: Rows) -> Target:
        """Grain to hide from the fit, given its current residual."""
        return texture.grain(self.pixels, residual)

    def texture(self, stream: Stream) -> Codes | None:
        """Texture codes for a coded picture without texture; None if it needs none."""
        if not self.replaces_grain:
            return None
        drawn = draw_whole(stream)
        if self.shown is not None:  # no texture where alpha hides it
            drawn = np.where(self.shown.values[..., None] > 0, drawn, self.pixels)
        return texture.estimate(self.pixels, drawn)

    def ssimulacra2(self, decoded: Pixels) -> float:
        """SSIMULACRA 2 of a decoded picture [H, W, 3], composited over grey; sides are at least 8 pixels."""
        pixels = self.pixels
        if self.shown is not None:
            share = np.sqrt(self.shown.values[..., None] / VISIBLE)
            decoded, pixels = (np.rint(GREY + share * (one - GREY)).astype(np.uint8) for one in (decoded, pixels))
        found = ssimulacra2(decoded, pixels, sampled=True)
        assert found is not None
        return found

    def error(self, decoded: Pixels) -> float:
        """Weighted sum of squared errors of a decoded picture [H, W, 3] without texture, 1 being white."""
        if self.visibility is None:
            return self.pixels.size * float(10 ** (-psnr(decoded, self.pixels) / 10))
        return visibility.error(self._with_coarse(self.visibility), decoded, self.pixels) / 255**2
