"""Quantise and refine: fitted Gaussians become the integers of a file, and its bytes."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sgmethod.backend.protocol import Moments, RefineLimits, Target
from sgmethod.bitstream.texture import Codes
from sgmethod.bitstream.v2 import StreamV2, is_upright
from sgmethod.rd.fit import error_of, take_step
from sgmethod.rd.rate_control import Coded, error_per_bit
from sgmethod.rd.request import Plan, State
from sgmethod.scene import Gaussians


@dataclass(frozen=True)
class Room:
    """What a file may hold: bytes of payload, beside a texture if there is one."""

    max_bytes: int
    texture: Codes | None


def quantised(plan: Plan, gaussians: Gaussians, target: Target, quantum: float, room: Room) -> Coded:
    """The coded picture with this quantum in the room there is, its integers refined one Gaussian at a time on the
    target that the others leave (native/refine/refine.cpp)."""
    request, s = plan.request, plan.settings
    is_short = request.rate.is_short
    quantum = StreamV2.coded_quantum(quantum, is_short)
    upright = is_upright(gaussians.factors, request.with_shear)
    finest, spacing = plan.finest, plan.finest.frame.spacing
    price = s.refine.weight * error_per_bit(quantum) / spacing**2
    limits = RefineLimits(price, s.effort.refine_sweeps, request.deadline.left_s(), room.max_bytes, spacing)
    coding = replace(request.coding(quantum), upright=upright)
    payload = request.backend.refine(gaussians, coding, target, limits, finest.visibility)
    colours = *request.size, quantum, request.background, request.grey, upright, payload
    stream = StreamV2(*colours, room.texture, is_short=is_short)
    return Coded(stream, request.objective)


def relaxed(plan: Plan, stream: StreamV2, target: Target, held: NDArray[np.bool_]) -> Gaussians:
    """The Gaussians [N] of a coded picture after some steps on what those of them that are held [N] leave of it."""
    s, level = plan.settings.refine, replace(plan.finest, target=target)
    before = stream.gaussians()
    moving, moments = before.copy(), Moments.none(len(before))
    price = s.relaxed_weight * error_per_bit(stream.quantum)
    for _ in range(s.relaxed_steps):
        take_step(plan, level, moving, moments, s.relaxed_rate, stream.quantum, price)
        for values, held_at in zip(moving.arrays, before.arrays, strict=True):
            values[held] = held_at[held]
    return moving


def rounded_psnr(plan: Plan, state: State) -> float:
    """Of the picture as it would decode now, in dB."""
    request = plan.request
    return exact_psnr(plan, request.backend.rounded(state.gaussians, request.coding(state.quantum)))


def exact_psnr(plan: Plan, gaussians: Gaussians) -> float:
    """Of Gaussians as they are, in dB."""
    return -10 * math.log10(max(error_of(plan, gaussians), 1e-12))
