"""Place: the first Gaussians, more and smaller ones where the picture has structure (paper, section III-B)."""

from __future__ import annotations

import numpy as np

from sgmethod.rd.plan import Plan
from sgmethod.scene import Gaussians
from sgmethod.start.placement import place_by_structure


def place(plan: Plan) -> Gaussians:
    """Place a part of the expected Gaussians, with colours that are solved together.

    As they are few, a small picture shows enough of the structure; if time is short, a smaller one has to do.
    """
    s, session = plan.settings.place, plan.session
    share = max(int(plan.rate.expected_gaussians() * s.share), s.fewest)
    n = min(share, plan.allowed_gaussians(plan.settings.effort.times, 1.0))
    few = plan.settings.pyramid.pixels_while_few
    level = plan.pyramid.coarsest(few * (n // 4 if session.deadline.is_short() else n))
    image = level.image().transpose(1, 2, 0) + np.array(plan.problem.background, np.float32) / 255
    placed = place_by_structure(np.ascontiguousarray(image), n, s.start, np.random.default_rng(session.seed))
    return level.solve_colors(level.shapes(placed.means, placed.factors), s.color_solve_steps)
