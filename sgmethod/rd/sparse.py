"""Sparse pictures: the fit sees only their islands, if these are much smaller than the level that it would need."""

from __future__ import annotations

import numpy as np

from sgmethod.backend.protocol import Backend, Frame
from sgmethod.fitting.islands import Islands
from sgmethod.fitting.level import Level, Pyramid, target_of
from sgmethod.rd.problem import Problem

LARGE = 1 << 18  # pixels of a picture; a smaller one is fitted in no time
SMALLER = 4  # times: an atlas's fit also takes time for moving Gaussians to it
# Pixels of an island's shorter side: words and stars. The wide Gaussians of a photograph reach far beyond its island,
# where the atlas shows no error.
NARROW = 64


def whole_of(problem: Problem, backend: Backend) -> Level:
    """Build the level of the whole picture."""
    target = target_of(problem.pixels, problem.background)
    return Level(backend, Frame(*problem.size), target, problem.objective.visibility)


def pyramid_of(problem: Problem, gaussians: int, backend: Backend) -> Pyramid:
    """Build the picture in the sizes that this many Gaussians can show or, if it is sparse, the atlas of its islands.

    With alpha, colours are all the same to hidden pixels, and seldom one colour.
    """
    whole, histogram = whole_of(problem, backend), problem.objective.histogram
    pyramid = Pyramid.from_whole(whole, gaussians)
    if whole.pixels < LARGE or not histogram.has_majority:
        return pyramid
    islands = Islands.from_pixels(problem.pixels, histogram.background)
    if islands is None or SMALLER * islands.pixels > pyramid.finest.pixels or problem.objective.shown is not None:
        return pyramid
    if any(min(box.width, box.height) > NARROW for box in islands.boxes):
        return pyramid
    colour = np.array([[histogram.background]], np.uint8)
    atlas = whole.atlas(islands, target_of(colour, problem.background))
    return Pyramid.from_whole(atlas, gaussians)
