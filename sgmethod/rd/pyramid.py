"""The picture at its own size, at half of it, and so on: few Gaussians learn as much from few pixels."""

from __future__ import annotations

from collections.abc import Callable
from itertools import takewhile

import cv2
import numpy as np

from sgmethod.fitting.picture import Picture, Target
from sgmethod.profiles import RdSettings, Times

SMALLEST_SIDE = 32  # pixels; smaller pictures are not halved


class Pyramid:
    """The levels of one picture, each half the size of the one before.

    finest: the finest level that Gaussians are fitted to. That is the whole picture, unless there is too little time
    for it. detailed: the levels that keep most of its contrast. On the others, thin lines and checkerboards have gone,
    and Gaussians would unlearn them.
    """

    def __init__(self, whole: Picture, settings: RdSettings) -> None:
        self.settings = settings
        self.finest = whole
        self.levels = [whole]
        for _ in range(settings.halvings):
            if min(self.levels[-1].height, self.levels[-1].width) >= SMALLEST_SIDE:
                self.levels.append(self.levels[-1].halved())
        least = settings.contrast_kept * _contrast(whole.target)
        self.detailed = list(takewhile(lambda level: _contrast(level.target) >= least, self.levels))

    def choose_finest(self, step_s: float, whole_s: float, gradient_s: Callable[[Picture], float]) -> None:
        """Take a smaller level for the finest where a gradient takes more seconds than there are for a step: the first
        that takes no more. A level is worth the detail it lacks if it takes at most half as long as the one before.

        whole_s: what a gradient of the whole picture takes; gradient_s: measures that of another level."""
        took_s = whole_s
        for level in self.levels[1:]:
            if took_s <= step_s:
                break
            took_s, before_s = gradient_s(level), took_s
            if took_s > before_s / 2:
                break
            self.finest = level

    def smallest(self, gaussians: int) -> Picture:
        """The smallest level that tells so many Gaussians what they need; none finer than the finest."""
        enough = self.settings.pixels_per_gaussian * gaussians
        coarser = [p for p in self.detailed if p.spacing > self.finest.spacing and p.height * p.width >= enough]
        return [self.finest, *coarser][-1]

    def at(self, progress: float, times: Times, gaussians: int) -> Picture:
        """The level for a part of the schedule: the smallest that will do, the finest in the end."""
        if progress >= times.halved_until:
            return self.finest
        return self.smallest(gaussians)


def _contrast(target: Target) -> float:
    """The variance of a picture, summed over its channels."""
    return float(sum(np.square(cv2.meanStdDev(plane)[1]).item() for plane in target))
