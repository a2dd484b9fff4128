"""Place: the first Gaussians, more and smaller ones where the picture has structure (paper, section III-B)."""

from __future__ import annotations

import numpy as np

from sgmethod.fitting.level import Pyramid
from sgmethod.rd.request import Request
from sgmethod.scene import Gaussians
from sgmethod.start.placement import place as place_by_structure


def place(request: Request, pyramid: Pyramid) -> Gaussians:
    """Place a part of the expected Gaussians, with colours that are solved together.

    As they are few, a small picture shows enough of the structure; if time is short, a smaller one has to do.
    """
    s, rate = request.settings.place, request.rate
    share = max(int(rate.expected_gaussians() * s.share), s.fewest)
    n = min(share, rate.allowed_gaussians(request.settings.effort.times, 1.0))
    few = request.settings.pyramid.pixels_while_few
    level = pyramid.coarsest(few * (n // 4 if request.deadline.is_short() else n))
    image = level.image().transpose(1, 2, 0) + np.array(request.background, np.float32) / 255
    placed = place_by_structure(np.ascontiguousarray(image), n, s.start, np.random.default_rng(request.seed))
    return level.solve_colors(level.shapes(placed.means, placed.factors), s.color_solve_steps)
