"""What an error counts: to the eye or in decibels, under alpha, with texture. Nobody else asks how a file is tuned."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sgmethod.backend.protocol import VISIBLE, Target, Visibility
from sgmethod.bitstream.stream import Stream
from sgmethod.bitstream.texture import Codes
from sgmethod.decoder import draw_whole
from sgmethod.fitting import texture, visibility
from sgmethod.fitting.bands import Rows
from sgmethod.fitting.moving_target import AheadForTheEye, BeyondBlackAndWhite, MovingTarget
from sgmethod.fitting.visibility import SeenShare
from sgmethod.metrics import psnr, ssimulacra2
from sgmethod.scene import FloatArray, Gaussians
from sgmethod.settings.rd import Effort, ObjectiveSettings
from sgmethod.settings.shared import Tune

Pixels = NDArray[np.uint8]
GREY = 128.0


@dataclass(frozen=True)
class Objective:
    """The error that one picture's encode minimises.

    pixels [H, W, 3]; visibility: what each pixel's error counts in the fit, None where all count alike; shown: the part
    of it that alpha decides; for_eye: tuned for the eye; is_alpha: the picture is an alpha plane, which may overshoot.
    """

    pixels: Pixels
    settings: ObjectiveSettings
    for_eye: bool = False
    is_alpha: bool = False
    shown: Visibility | None = None
    visibility: Visibility | None = None
    seen_share: SeenShare | None = None

    @classmethod
    def of(cls, pixels: Pixels, tune: Tune, settings: ObjectiveSettings, alpha: Pixels | None = None) -> Objective:
        """For colours [H, W, 3], shown by alpha [H, W] where they are not opaque."""
        shown = None if alpha is None else visibility.of_alpha(alpha)
        seen = visibility.of_detail(pixels, settings.visibility, shown) if tune == "visual" else shown
        share = None if seen is None else SeenShare(seen)
        return cls(pixels, settings, tune == "visual", False, shown, seen, share)

    @classmethod
    def of_alpha(cls, alpha: Pixels, settings: ObjectiveSettings) -> Objective:
        """For an alpha plane [H, W]."""
        return cls(np.repeat(alpha[..., None], 3, axis=2), settings, is_alpha=True)

    def under(self, pixels: Pixels, alpha: Pixels) -> Objective:
        """The same for colours [H, W, 3] under alpha [H, W]."""
        return Objective.of(pixels, "visual" if self.for_eye else "psnr", self.settings, alpha)

    def moving_target(self, target: Target, spacing: int, background: int) -> MovingTarget:
        """How the target of the fit moves. spacing: of its samples, in pixels; background: the level below it, of
        alpha."""
        if self.is_alpha:
            return BeyondBlackAndWhite(target, background, self.settings.moving)
        shrink = self.settings.moving.shrink // spacing
        if self.for_eye and shrink > 1:
            return AheadForTheEye(target, shrink, self.settings.moving)
        return MovingTarget(target)  # where all errors are coarse, they count alike

    def hidden_by(self, effort: Effort) -> int:
        """Coarser sizes whose gains hide a place of growth: few where the target moves, which leaves coarse errors."""
        return effort.hidden_by_moving if self.for_eye else effort.hidden_by

    def energies(self, gaussians: Gaussians) -> FloatArray:
        """[N]: the squared error that each Gaussian alone would leave if it were dropped."""
        l1, l3 = gaussians.factors[:, 0], gaussians.factors[:, 2]
        energies = np.float32(np.pi) * l1 * l3 * np.square(gaussians.colors).sum(1)
        return np.asarray(energies if self.seen_share is None else energies * self.seen_share.of(gaussians), np.float32)

    def grain(self, residual: Rows) -> Target:
        """Grain to hide from the fit, given its residual now."""
        return texture.grain(self.pixels, residual, self.settings.texture)

    def texture(self, stream: Stream) -> Codes | None:
        """Texture to go with a coded picture that has none; None for none."""
        if not self.for_eye:
            return None
        drawn = draw_whole(stream)
        if self.shown is not None:  # no texture where alpha hides it
            drawn = np.where(self.shown.values[..., None] > 0, drawn, self.pixels)
        return texture.estimate(self.pixels, drawn, self.settings.texture)

    def looks(self, decoded: Pixels) -> float:
        """SSIMULACRA 2 of a decoded picture [H, W, 3], on grey where alpha shows it in part. No side is below
        8 pixels."""
        pixels = self.pixels
        if self.shown is not None:
            share = np.sqrt(self.shown.values[..., None] / VISIBLE)
            decoded, pixels = (np.rint(GREY + share * (one - GREY)).astype(np.uint8) for one in (decoded, pixels))
        found = ssimulacra2(decoded, pixels)
        assert found is not None
        return found

    def error(self, decoded: Pixels) -> float:
        """Of a decoded picture [H, W, 3] without texture: squared, summed, 1 being white."""
        if self.visibility is None:
            return self.pixels.size * float(10 ** (-psnr(decoded, self.pixels) / 10))
        return visibility.error(self.visibility, decoded, self.pixels) / 255**2
