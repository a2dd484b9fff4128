"""The picture at its own size, at half of it, and so on: few Gaussians learn as much from few pixels."""

from __future__ import annotations

from itertools import takewhile

import cv2
import numpy as np

from sgmethod.fitting.picture import Picture, Target
from sgmethod.profiles import RdSettings, Times

SMALLEST_SIDE = 32  # pixels; smaller pictures are not halved


class Pyramid:
    """The levels of one picture, each half the size of the one before.

    whole: the picture itself; finest: the level that Gaussians are fitted to for most of the schedule. That is the
    whole picture, unless there is too little time for it. detailed: the levels that keep most of its contrast. On the
    others, thin lines and checkerboards have gone, and Gaussians would unlearn them.
    """

    def __init__(self, whole: Picture, settings: RdSettings) -> None:
        self.settings = settings
        self.whole = self.finest = whole
        self.levels = [whole]
        for _ in range(settings.halvings):
            if min(self.levels[-1].height, self.levels[-1].width) >= SMALLEST_SIDE:
                self.levels.append(self.levels[-1].halved())
        least = settings.contrast_kept * _contrast(whole.target)
        self.detailed = list(takewhile(lambda level: _contrast(level.target) >= least, self.levels))

    def choose_finest(self, seconds: float, needed: float) -> None:
        """Take a smaller level for the finest where all steps would need more seconds than there are. Each level takes
        a quarter of the time of the one before."""
        level = 0
        while seconds < needed and level < len(self.levels) - 1:
            needed, level = needed / 4, level + 1
        self.finest = self.levels[level]

    def smallest(self, gaussians: int) -> Picture:
        """The smallest level that tells so many Gaussians what they need; none finer than the finest."""
        enough = self.settings.pixels_per_gaussian * gaussians
        coarser = [p for p in self.detailed if p.spacing > self.finest.spacing and p.height * p.width >= enough]
        return [self.finest, *coarser][-1]

    def at(self, progress: float, times: Times, gaussians: int) -> Picture:
        """The level for a part of the schedule: the smallest that will do, the whole picture in the end."""
        if progress >= times.whole_from:
            return self.whole
        if progress >= times.halved_until:
            return self.finest
        return self.smallest(gaussians)


def _contrast(target: Target) -> float:
    """The variance of a picture, summed over its channels."""
    return float(sum(np.square(cv2.meanStdDev(plane)[1]).item() for plane in target))
