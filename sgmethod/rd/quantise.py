"""Quantise and refine: fitted Gaussians become the integers of a file and its bytes."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sgmethod.backend.protocol import Moments, RefineLimits, Target
from sgmethod.bitstream.texture import Codes
from sgmethod.bitstream.v2 import StreamV2, is_upright
from sgmethod.rd.plan import Plan
from sgmethod.rd.rate_control import Coded, error_per_bit
from sgmethod.scene import Gaussians


@dataclass(frozen=True)
class PayloadLimit:
    """Limit on the payload of a file, which may hold a texture beside it."""

    max_bytes: int
    texture: Codes | None


def quantised(plan: Plan, gaussians: Gaussians, target: Target, quantum: float, limit: PayloadLimit) -> Coded:
    """Code Gaussians with this quantum within a limit.

    Their integers are refined one Gaussian at a time on the target that the others leave (native/refine/refine.cpp).
    """
    request, s = plan.request, plan.settings
    is_short = request.rate.is_short
    quantum = StreamV2.coded_quantum(quantum, is_short)
    upright = is_upright(gaussians.factors, request.with_shear)
    finest, spacing = plan.finest, plan.finest.frame.spacing
    price = s.refine.weight * error_per_bit(quantum) / spacing**2
    limits = RefineLimits(price, s.effort.refine_sweeps, request.deadline.left_s(), limit.max_bytes, spacing)
    coding = replace(request.coding(quantum), upright=upright)
    payload = request.backend.refine(gaussians, coding, target, limits, finest.visibility)
    colours = *request.size, quantum, request.background, request.grey, upright, payload
    stream = StreamV2(*colours, limit.texture, is_short=is_short)
    return Coded(stream, request.objective)


def relaxed(plan: Plan, stream: StreamV2, target: Target, held: NDArray[np.bool_]) -> Gaussians:
    """Take some steps with the Gaussians [N] of a coded picture, except those that are held [N]."""
    s, level = plan.settings.refine, replace(plan.finest, target=target)
    before = stream.gaussians()
    moving, moments = before.copy(), Moments.none(len(before))
    price = s.relaxed_weight * error_per_bit(stream.quantum)
    descent = plan.descent(level, stream.quantum, price)
    for _ in range(s.relaxed_steps):
        plan.request.backend.steps(moving, moments, descent, [s.relaxed_rate])
        for values, held_at in zip(moving.arrays, before.arrays, strict=True):
            values[held] = held_at[held]
    return moving
