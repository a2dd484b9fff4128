"""Fits of the trial: the sum and the mixture with the same optimiser, growth and price of bits."""

from __future__ import annotations

import ctypes
import math
import subprocess
import tempfile
from dataclasses import dataclass, field, replace
from functools import cache
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float32]
STEPS_TOGETHER = 10
GROWTH_AT = (0.0, 0.06, 0.12, 0.18, 0.24, 0.3, 0.37, 0.45, 0.55, 0.65)
TRIM_AT = (0.72, 0.78, 0.82, 0.86, 0.9, 0.94, 0.97, 0.99)
ROUND_GROWTH = (0.0, 0.1, 0.2)
ROUND_TRIM = (0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.88, 0.94, 0.98)
SYMBOLS, CONTEXTS, PRIOR, TRAINED, HEADER_BITS = 20, 80, 12.0, 20.0, 96
SCALES = (0.7, 1.0, 1.5, 2.2, 3.3, 5.0, 7.5, 11.0, 17.0, 26.0, 40.0)


class SceneHead(ctypes.Structure):
    _fields_ = [(n, ctypes.c_int) for n in ("width", "height", "count", "mixture")]
    _fields_ += [(n, ctypes.c_float) for n in ("reach", "gamma", "log_e")] + [("b", ctypes.c_float * 3)]


class FitHead(ctypes.Structure):
    _fields_ = [
        (n, ctypes.c_float)
        for n in ("rate", "price", "quantum", "beta1", "beta2", "newton", "amplitude_rate", "ground_rate")
    ]
    _fields_ += [(n, ctypes.c_int) for n in ("steps", "amplitudes")]


@cache
def library() -> ctypes.CDLL:
    """Compile the kernels beside this file."""
    built = Path(tempfile.mkdtemp()) / "kernel.so"
    flags = ["-O3", "-march=native", "-ffast-math", "-fopenmp-simd", "-shared", "-fPIC"]
    subprocess.run(["g++", *flags, "-o", built, Path(__file__).with_name("kernel.cpp")], check=True)
    found = ctypes.CDLL(str(built))
    for name in ("errors", "fit", "refine"):
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
    steps: int = 300
    rate_weight: float = 1.7
    rounds: int = 0
    bits_of_new: float = 20.0
    rate: float = 0.14
    amplitude_rate: float = 1.0
    excess: float = 0.5
    refine_weight: float = 0.35
    place_step: float = 1.4
    shape_step: float = 1.0
    amplitude_step: float = 0.7
    sweeps: int = 12
    color_step: float = 1.0


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
    scale = 1 / (2 * bend[:, 6:] + np.float32(1e-2))
    residual = -by[:, 6:]
    direction = z = residual * scale
    rho = float((residual * z).sum())
    zero, b = np.zeros_like(target), list(f.head.b)
    for _ in range(steps):
        q = p.copy()
        q[:, 6:] = direction
        f.head.b[:] = [0.0] * 3
        along = gradient(f, q, zero)[1][:, 6:] + np.float32(2e-3) * direction
        f.head.b[:] = b
        step = rho / max(float((direction * along).sum()), 1e-12)
        p[:, 6:] += step * direction
        residual -= np.float32(step) * along
        z = residual * scale
        rho, before = float((residual * z).sum()), rho
        direction = z + np.float32(rho / max(before, 1e-20)) * direction
    f.p = p


def grow(f: Fitted, target: Array, v: Variant, most: int, least_gain: float) -> Fitted:
    """Add the round kernels that gain most, none within another's reach."""
    found = []
    shares = np.array(v.shares if v.amplitudes == "free" else (0.5,), np.float32)
    h, w = target.shape[1:]
    missing = np.ascontiguousarray((target - drawn(f)).transpose(1, 2, 0))
    for scale in SCALES:
        if scale > max(h, w) / 4:
            continue
        stride = max(1, int(scale / 1.4))
        out = np.empty((h // stride, w // stride, 5), np.float32)
        blurred = cv2.GaussianBlur(missing, (0, 0), scale)[stride // 2 :: stride, stride // 2 :: stride]
        strength = np.square(blurred[: out.shape[0], : out.shape[1]]).sum(2)
        places = (strength >= cv2.dilate(strength, np.ones((3, 3), np.uint8))).astype(np.uint8)
        args = ctypes.c_float(scale), stride, at(shares), len(shares), at(places), at(out)
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


def run_steps(
    f: Fitted, target: Array, v: Variant, steps: int, start: float, end: float, price: float, q: float
) -> Fitted:
    """Take steps; rates fall along a cosine from part `start` to part `end` of a run to a half."""
    done = 0
    while done < steps:
        n = min(STEPS_TOGETHER, steps - done)
        if v.mixture and price > 0:
            f = f.sorted()
        predicted = np.zeros((len(f.p), 3), np.float32)
        if v.mixture and price > 0:
            library().predictions(ctypes.byref(f.head), at(f.p), at(predicted))
        part = start + (end - start) * done / steps
        rate = v.rate * (0.75 + 0.25 * math.cos(math.pi * part))
        free = int(v.mixture and v.amplitudes == "free")
        head = FitHead(rate, price, q, 0.9, 0.99, 2.0, v.amplitude_rate, 0.5, n, free)
        f.p = np.ascontiguousarray(f.p)
        args = at(f.p), at(target), at(predicted), at(f.moments), at(f.ground), at(f.ages), ctypes.byref(head)
        library().fit(ctypes.byref(f.head), *args)
        done += n
    return f


class Coding(ctypes.Structure):
    _fields_ = [
        (n, ctypes.c_float)
        for n in (
            "quantum",
            "place_step",
            "shape_step",
            "amplitude_step",
            "price",
            "color_step",
        )
    ]
    _fields_ += [(n, ctypes.c_int) for n in ("amplitudes", "sweeps")]


@dataclass
class Coded:
    """A file that could be written: its kernels as a decoder has them, its bits, and the models' counts."""

    head: SceneHead
    p: Array
    bits: float
    counts: Array
    parts: NDArray[np.float64]
    float_psnr: float

    def image(self) -> NDArray[np.uint8]:
        fitted = Fitted(self.head, self.p, self.p, np.zeros(1, np.int32))
        return np.clip(np.rint(drawn(fitted) * 255), 0, 255).astype(np.uint8)

    def psnr(self, target: Array) -> float:
        return psnr(self.image().astype(np.float32) * np.float32(1 / 255), target)


def prior_of(shares: list[str] | None = None) -> Array:
    """What models of symbols start with: trained shares, or plain ones."""
    if shares is not None:
        p = np.array([line.split() for line in shares], np.float64)
        return np.ascontiguousarray(TRAINED * p / p.sum(1, keepdims=True), np.float32)
    plain = 0.7 ** np.arange(SYMBOLS)
    return np.tile((PRIOR * plain / plain.sum()).astype(np.float32), (CONTEXTS, 1))


def symbol_shares(counts: Array) -> list[str]:
    """Shares of symbols, a line for each context, from how often each came."""
    p = counts + 0.001 * counts.sum(1, keepdims=True) + 0.3 * 0.7 ** np.arange(SYMBOLS)
    return [" ".join(map(str, line)) for line in np.maximum(np.rint(2000 * p / p.sum(1, keepdims=True)), 1).astype(int)]


def bit_price(quantum: float) -> float:
    """Squared error that a bit is worth: of a uniform quantiser, a colour's with this quantum."""
    return math.pi * quantum**2 * math.log(2) / 6


def code(f: Fitted, target: Array, v: Variant, quantum: float, sweeps: int, prior: Array) -> Coded:
    """Round, refine and count."""
    head = SceneHead.from_buffer_copy(f.head)
    head.log_e = round(head.log_e * 8) / 8
    for j in range(3):
        head.b[j] = round(head.b[j] * 255) / 255
    g = replace(f, head=head, p=f.p.copy())
    _, _, bend = gradient(g, g.p, target)
    free = int(v.mixture and v.amplitudes == "free")
    price = v.refine_weight * bit_price(quantum)
    q = Coding(quantum, v.place_step, v.shape_step, v.amplitude_step, price, v.color_step, free, sweeps)
    count, ints = ctypes.c_int(), np.empty((len(f.p), 11), np.int32)
    counts, parts = np.empty((CONTEXTS, SYMBOLS), np.float32), np.empty(5)
    args = at(target), ctypes.byref(q), at(prior), ctypes.byref(count), at(ints), at(counts), at(parts)
    bits = library().refine(ctypes.byref(head), at(g.p), at(bend), *args)
    head.count = count.value
    return Coded(
        head,
        g.p[: count.value],
        bits + HEADER_BITS + 8 * v.mixture,
        counts,
        parts,
        psnr(drawn(f), target) if sweeps else 0,
    )


def fit_bits(target: Array, v: Variant, budget: float, prior: Array) -> tuple[Fitted, float]:
    """Fit kernels whose file is to have `budget` bits, with a price of bits. Returns the quantum as well."""
    f, n = empty(target, v), budget / 27
    goal = 0.0013 * target[0].size / n
    quantum = goal / 4
    for run in range(1 + v.rounds):
        times = (*GROWTH_AT, *TRIM_AT, 1.0) if run == 0 else (*ROUND_GROWTH, *ROUND_TRIM, 1.0)
        growth = GROWTH_AT if run == 0 else ROUND_GROWTH
        steps, surplus_until = (v.steps, 0.88) if run == 0 else (round(v.steps * 0.4), 0.6)
        surplus_from = 0.45 if run == 0 else 0.0
        excess = v.excess if run == 0 else 1.0
        for here, then in pairwise(times):
            left = 1 - min(max((here - surplus_from) / (surplus_until - surplus_from), 0), 1)
            if len(f.p) and (here >= 0.12 or run):
                bits = code(f, target, v, quantum, 0, prior).bits
                most = (budget * 1.08) * (1 + excess * left)  # refining drops some
                change = (bits / most) ** (0.9 if here in growth else 1.0)
                quantum *= min(max(change, 1 / 1.35), 1.35)
            price = bit_price(quantum)
            f = strongest(f, target, 10**6, price * (4.3 if here < growth[-1] else 18.0))
            if here in growth:
                most_n = min(int(5 * n), target[0].size // 4) - len(f.p)
                before = len(f.p)
                least = v.rate_weight * price * v.bits_of_new
                f = grow(f, target, v, min(most_n, max(before, int(n / 10), 4)), least)
                if len(f.p) > before:
                    solve_colours(f, target)
            n_steps = round(steps * then) - round(steps * here)
            f = run_steps(f, target, v, n_steps, here, then, v.rate_weight * price, quantum)
    return f, quantum


def search(f: Fitted, quantum: float, target: Array, v: Variant, budget: float, prior: Array) -> list[Coded]:
    """Files on both sides of the budget, near it."""
    found: list[tuple[float, Coded]] = []
    for _ in range(7):
        one = code(f, target, v, quantum, v.sweeps, prior)
        found.append((quantum, one))
        if abs(one.bits / budget - 1) < 0.004:
            break
        above = [(q, c) for q, c in found if c.bits > budget]
        below = [(q, c) for q, c in found if c.bits <= budget]
        if above and below:
            (q0, a), (q1, b) = max(above, key=lambda x: x[0]), min(below, key=lambda x: x[0])
            part = math.log(a.bits / budget) / max(math.log(a.bits / b.bits), 1e-9)
            quantum = q0 * (q1 / q0) ** min(max(part, 0.1), 0.9)
        else:
            quantum *= min(max((one.bits / budget) ** 1.4, 0.6), 1.6)
    return [c for _, c in found]


def at_budget(files: list[Coded], target: Array, budget: float) -> tuple[float, Coded]:
    """PSNR at exactly the budget, by the slope of 6.02 dB for each doubling over two bits of three at this point."""
    nearest = min(files, key=lambda c: abs(math.log(c.bits / budget)))
    return nearest.psnr(target) + 2.95 * math.log2(budget / nearest.bits), nearest
