"""Learned uniform quantisers: LSQ with a fixed bitwidth, ABQ with a learned one per Gaussian (paper, section III-C).

    v^ = s q + Z,   q = clamp(round((v - Z) / s), 0, Q),   Q = 2^B - 1,   Z = v_min,   s = (v_max - v_min) / Q

v_min, v_max and the soft bitwidth b (B = round(b)) learn through rounding by the straight-through estimator.
"""

from __future__ import annotations

import math
from typing import Any

import torch
from torch import Tensor


class _Quantise(torch.autograd.Function):
    """Quantisation with straight-through gradients.

    With the rounding of u and of B taken as constant offsets, in range

        dv^/dv = 1,  dv^/dv_max = q/Q - u/Q,  dv^/dv_min = u/Q - q/Q,  dv^/db = 2^B ln2 / Q (v - v^),

    where u = (v - Z) / s. Out of range, q is 0 or Q whatever v and B are: dv^/dv_max = q/Q, dv^/dv_min = 1 - q/Q,
    dv^/dv = dv^/db = 0. In dv^/db, the paper prints v - q in range in place of v - v^, and -s q out of range (equation
    7). Both contradict finite differences (tests/paper/test_quantise.py). `printed` selects them.
    """

    @staticmethod
    def forward(ctx: Any, v: Tensor, low: Tensor, high: Tensor, bits: Tensor, printed: bool) -> Tensor:
        top = torch.exp2(torch.round(bits)) - 1
        step = (high - low) / top
        u = (v - low) / step
        q = torch.round(u).clamp_(min=torch.zeros_like(top), max=top)
        out = low + step * q
        inside = (u >= 0) & (u <= top)
        error = torch.where(inside, v - q, -step * q) if printed else torch.where(inside, v - out, 0.0)
        ctx.save_for_backward(u, q, top, inside, error)
        ctx.shapes = low.shape, high.shape, bits.shape
        return out

    @staticmethod
    def backward(ctx: Any, *grads: Any) -> tuple[Tensor, Tensor, Tensor, Tensor, None]:
        u, q, top, inside, error = ctx.saved_tensors
        (grad,) = grads
        share = q / top - torch.where(inside, u / top, 0.0)  # dv^/dv_max
        grad_low = torch.where(inside, -share, 1 - q / top) * grad
        grad_bits = (top + 1) * math.log(2) / top * error * grad
        low, high, bits = ctx.shapes
        return (
            torch.where(inside, grad, 0.0),
            grad_low.sum_to_size(low),
            (share * grad).sum_to_size(high),
            grad_bits.sum_to_size(bits),
            None,
        )


def quantise(v: Tensor, low: Tensor, high: Tensor, bits: Tensor, printed: bool = False) -> Tensor:
    """Quantise v [N, K] to v^, differentiable in all arguments.

    low, high [K]: ends of the ranges; bits [N, 1] (ABQ, one soft bitwidth per row) or [1] (LSQ); printed: the
    gradient by bits is the paper's.
    """
    out: Tensor = _Quantise.apply(v, low, high, bits, printed)  # type: ignore[no-untyped-call]
    return out


def codes(v: Tensor, low: Tensor, high: Tensor, bits: Tensor) -> Tensor:
    """Integer codes q of v, int64; shapes as for quantise()."""
    top = torch.exp2(torch.round(bits)) - 1
    q = torch.round((v.double() - low.double()) / ((high.double() - low.double()) / top))
    return torch.minimum(q.clamp_min(0), top.double()).long()
