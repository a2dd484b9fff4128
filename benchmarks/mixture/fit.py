"""Fits of the trial: the sum and the mixture with the same optimiser, growth and price of bits."""

from __future__ import annotations

import ctypes
import math
import subprocess
import tempfile
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float32]
STEPS_TOGETHER = 10
GROWTH_AT = (0.0, 0.06, 0.12, 0.18, 0.24, 0.3, 0.37, 0.45, 0.55, 0.65)
SCALES = (0.7, 1.0, 1.5, 2.2, 3.3, 5.0, 7.5, 11.0, 17.0, 26.0, 40.0)


class SceneHead(ctypes.Structure):
    _fields_ = [(n, ctypes.c_int) for n in ("width", "height", "count", "mixture")]
    _fields_ += [(n, ctypes.c_float) for n in ("reach", "gamma", "log_e")] + [("b", ctypes.c_float * 3)]


class FitHead(ctypes.Structure):
    _fields_ = [
        (n, ctypes.c_float)
        for n in "rate price quantum beta1 beta2 newton floor_bits amplitude_rate ground_rate".split()
    ]
    _fields_ += [(n, ctypes.c_int) for n in ("steps", "amplitudes", "t")]


@cache
def library() -> ctypes.CDLL:
    """Compile the kernels beside this file."""
    built = Path(tempfile.mkdtemp()) / "kernel.so"
    flags = "-O3 -march=native -ffast-math -fopenmp-simd -shared -fPIC".split()
    subprocess.run(["g++", *flags, "-o", built, Path(__file__).with_name("kernel.cpp")], check=True)
    found = ctypes.CDLL(str(built))
    for name in ("errors", "fit", "refine"):
        if hasattr(found, name):
            getattr(found, name).restype = ctypes.c_double
    return found


def at(a: NDArray[np.generic]) -> ctypes.c_void_p:
    assert a.flags.c_contiguous
    return ctypes.c_void_p(a.ctypes.data)


@dataclass(frozen=True)
class Variant:
    """What is tried. amplitudes: "none", "scale" (log a = -gamma log size) or "free"."""

    mixture: bool = True
    reach: float = 4.0
    amplitudes: str = "free"
    gamma: float = 0.0
    log_e: float = -5.0
    shares: tuple[float, ...] = (0.33, 0.67, 0.9)
    wider: float = 1.0
    steps: int = 300
    rate_weight: float = 1.7
    rounds: int = 0
    bits_of_new: float = 20.0
    rate: float = 0.14
    amplitude_rate: float = 1.0
    excess: float = 0.5


@dataclass
class Fitted:
    """Kernels [N, 9] as in kernel.cpp, and what the optimiser remembers."""

    head: SceneHead
    p: Array
    moments: Array
    ages: NDArray[np.int32]
    ground: Array = field(default_factory=lambda: np.zeros((4, 2), np.float32))

    def rows(self, keep: NDArray[np.intp]) -> Fitted:
        ages = np.concatenate([self.ages[:-1][keep], self.ages[-1:]])
        return replace(self, p=self.p[keep].copy(), moments=self.moments[keep].copy(), ages=ages).counted()

    def counted(self) -> Fitted:
        self.head.count = len(self.p)
        return self

    def more(self, p: Array) -> Fitted:
        ages = np.concatenate([self.ages[:-1], np.zeros(len(p), np.int32), self.ages[-1:]])
        moments = np.concatenate([self.moments, np.zeros((len(p), 9, 2), np.float32)])
        return replace(self, p=np.concatenate([self.p, p]), moments=moments, ages=ages).counted()

    def sorted(self) -> Fitted:
        """Largest first."""
        return self.rows(np.argsort(-self.p[:, 2] * self.p[:, 4], kind="stable"))


def empty(target: Array, v: Variant) -> Fitted:
    h, w = target.shape[1:]
    mean = target.mean((1, 2))
    head = SceneHead(w, h, 0, int(v.mixture), v.reach, v.gamma, v.log_e, (ctypes.c_float * 3)(*mean))
    return Fitted(head, np.zeros((0, 9), np.float32), np.zeros((0, 9, 2), np.float32), np.zeros(1, np.int32))


def drawn(f: Fitted) -> Array:
    out = np.empty((3, f.head.height, f.head.width), np.float32)
    library().draw(ctypes.byref(f.head), at(f.p), at(out))
    return out


def psnr(image: Array, target: Array) -> float:
    return -10 * math.log10(float(np.mean((np.clip(image, 0, 1) - target) ** 2)))


def gradient(f: Fitted, p: Array, target: Array) -> tuple[float, Array, Array]:
    by, bend, ground = np.empty((len(p), 9), np.float32), np.empty((len(p), 7), np.float32), np.empty(8, np.float32)
    error = library().errors(ctypes.byref(f.head), at(p), at(target), at(by), at(bend), at(ground))
    return error, by, bend


def solve_colours(f: Fitted, target: Array, steps: int = 4) -> None:
    """Conjugate gradients on the colours, in which both models are linear."""
    p = f.p.copy()
    _, by, bend = gradient(f, p, target)
    scale = 1 / (2 * bend[:, 6:] + 1e-2)
    residual = -by[:, 6:]
    direction = z = residual * scale
    rho = float((residual * z).sum())
    zero, b = np.zeros_like(target), list(f.head.b)
    for _ in range(steps):
        q = p.copy()
        q[:, 6:] = direction
        f.head.b[:] = [0.0] * 3
        along = gradient(f, q, zero)[1][:, 6:] + 2e-3 * direction
        f.head.b[:] = b
        step = rho / max(float((direction * along).sum()), 1e-12)
        p[:, 6:] += step * direction
        residual = residual - step * along
        z = residual * scale
        rho, before = float((residual * z).sum()), rho
        direction = z + rho / max(before, 1e-20) * direction
    f.p = p


def grow(f: Fitted, target: Array, v: Variant, most: int, least_gain: float) -> Fitted:
    """Add the round kernels that gain most, none within another's reach."""
    found = []
    shares = np.array(v.shares if v.amplitudes == "free" else (0.5,), np.float32)
    h, w = target.shape[1:]
    for scale in SCALES:
        if scale > max(h, w) / 4:
            continue
        stride = max(1, int(scale / 1.4))
        out = np.empty((h // stride, w // stride, 5), np.float32)
        args = ctypes.c_float(scale), stride, at(shares), len(shares), at(out)
        library().gains(ctypes.byref(f.head), at(f.p), at(target), *args)
        y, x = np.nonzero(out[..., 0] > least_gain)
        place = np.stack([(x + 0.5) * stride, (y + 0.5) * stride, np.full(len(x), scale)], 1)
        found.append(np.concatenate([place, out[y, x]], 1))
    all_ = np.concatenate(found)
    all_ = all_[np.argsort(-all_[:, 3], kind="stable")]
    chosen = np.empty(most, np.int32)
    places = np.ascontiguousarray(all_[:, :3], np.float32)
    count = library().apart(at(places), len(places), most, at(chosen))
    if count == 0:
        return f
    c = all_[chosen[:count]].astype(np.float32)
    p = np.zeros((len(c), 9), np.float32)
    p[:, :2], p[:, 2], p[:, 4] = c[:, :2], c[:, 2], c[:, 2]
    if v.mixture and v.amplitudes == "free":
        p[:, 5] = np.log(c[:, 4]) + v.gamma * np.log(c[:, 2])
    p[:, 6:] = np.clip(c[:, 5:], -0.5, 1.5) if v.mixture else c[:, 5:]
    return f.more(p)


def losses(f: Fitted, target: Array) -> Array:
    out = np.empty(len(f.p), np.float32)
    library().losses(ctypes.byref(f.head), at(f.p), at(target), at(out))
    return out


def strongest(f: Fitted, target: Array, most: int, least: float) -> Fitted:
    """Drop kernels without which the error hardly rises."""
    if len(f.p) == 0:
        return f
    loss = losses(f, target)
    keep = np.flatnonzero(loss > least)
    if len(keep) > most:
        keep = np.sort(keep[np.argsort(-loss[keep], kind="stable")[:most]])
    return f.rows(keep) if len(keep) < len(f.p) else f


def run_steps(f: Fitted, target: Array, v: Variant, steps: int, start: float, end: float, price: float, q: float) -> Fitted:
    """Take steps; rates fall along a cosine from part `start` to part `end` of a run to a half."""
    done = 0
    while done < steps:
        n = min(STEPS_TOGETHER, steps - done)
        if v.mixture and price > 0:
            f = f.sorted()
        predicted = np.zeros((len(f.p), 3), np.float32)
        if v.mixture and price > 0:
            library().predictions(ctypes.byref(f.head), at(f.p), ctypes.c_float(v.wider), at(predicted))
        part = start + (end - start) * done / steps
        rate = v.rate * (0.75 + 0.25 * math.cos(math.pi * part))
        free = int(v.mixture and v.amplitudes == "free")
        head = FitHead(rate, price, q, 0.9, 0.99, 2.0, 0, v.amplitude_rate, 0.5, n, free, 0)
        f.p = np.ascontiguousarray(f.p)
        args = at(f.p), at(target), at(predicted), at(f.moments), at(f.ground), at(f.ages), ctypes.byref(head)
        library().fit(ctypes.byref(f.head), *args)
        done += n
    return f


def fit_count(target: Array, v: Variant, count: int) -> Fitted:
    """Fit a number of kernels, without a price of bits: surplus until 0.88 of the run."""
    f = empty(target, v)
    for i, here in enumerate((*GROWTH_AT, 0.72, 0.78, 0.82, 0.86, 0.9, 0.94, 0.97, 0.99)):
        times = (*GROWTH_AT, 0.72, 0.78, 0.82, 0.86, 0.9, 0.94, 0.97, 0.99, 1.0)
        left = 1 - min(max((here - 0.45) / 0.43, 0), 1)
        most = round(count * (1 + v.excess * left))
        f = strongest(f, target, most, 0)
        if here in GROWTH_AT and len(f.p) < most:
            f = grow(f, target, v, min(most - len(f.p), max(len(f.p), count // 8, 4)), 0)
            solve_colours(f, target)
        n = round(v.steps * times[i + 1]) - round(v.steps * here)
        f = run_steps(f, target, v, n, here, times[i + 1], 0.0, 1.0)
    return f
