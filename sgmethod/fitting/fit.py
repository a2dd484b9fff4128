"""Fitting Gaussians to a picture: the optimiser, its schedule, its trace of error against time.

The optimiser is Adam in each Gaussian's own frame. With the factor L, a mean moves by L d and the factor by
L S, S lower triangular, so that a rate means the same relative change for a speck and for a wide, tilted
ellipse. On five photographs this was worth as much as three times the steps of Adam on plain parameters.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from sgmethod.bitstream import v1
from sgmethod.budget import Budget
from sgmethod.errors import BudgetError
from sgmethod.native import native
from sgmethod.profiles import OptimiserSettings, Settings
from sgmethod.scene import FloatArray, Gaussians
from sgmethod.trace import Progress, TracePoint

REPORT_INTERVAL_S = 0.1
PERFECT_MSE = 1e-7  # 70 dB: a tenth of what rounding to 8 bits leaves
PROGRESS_DB = 0.01  # what counts as progress


class Clock:
    """Seconds since the encode began, and its limit."""

    def __init__(self, limit_s: float | None = None) -> None:
        self.start = time.perf_counter()
        self.limit_s = limit_s

    def seconds(self) -> float:
        """Seconds since the start."""
        return time.perf_counter() - self.start


class Recorder:
    """Collects the trace and hands it on, at most every REPORT_INTERVAL_S."""

    def __init__(self, clock: Clock, on_progress: Progress | None) -> None:
        self.clock, self.on_progress = clock, on_progress
        self.points: list[TracePoint] = []
        self._interval_s = REPORT_INTERVAL_S

    def due(self) -> bool:
        """Whether the next point of a phase will be taken."""
        return not self.points or self.clock.seconds() - self.points[-1].seconds >= self._interval_s

    def measured(self, error: Callable[[], float]) -> float:
        """An error that only the trace needs. Measuring takes no more than a tenth of the time."""
        began = self.clock.seconds()
        mse = error()
        self._interval_s = max(REPORT_INTERVAL_S, 10 * (self.clock.seconds() - began))
        return mse

    def report(self, phase: str, step: int, steps: int, mse: float, counts: tuple[int, int]) -> None:
        """Add a point; counts = (number of Gaussians, bits of the file or 0)."""
        new_phase = not self.points or self.points[-1].phase != phase
        if not (new_phase or step == steps or self.due()):
            return
        seconds = self.clock.seconds()
        psnr = -10 * math.log10(max(mse, 1e-12))
        gaussians, bits = counts
        point = TracePoint(round(seconds, 4), step, steps, round(psnr, 4), -(-bits // 8), gaussians, phase)
        self.points.append(point)
        if self.on_progress:
            self.on_progress(point)


RESERVE_S = 0.15  # plus RESERVE_S_PER_MEGAPIXEL, kept back of a time limit for writing and measuring the file
RESERVE_S_PER_MEGAPIXEL = 0.5


@dataclass(frozen=True)
class Task:
    """One encode as asked for: pixels [H, W, 3] in [0, 1], and what encode() was given with them."""

    pixels: FloatArray
    budget: Budget
    profile: str
    seed: int
    recorder: Recorder

    def until_s(self) -> float | None:
        """The second, on the recorder's clock, at which fitting must be over; None without a time limit."""
        limit = self.recorder.clock.limit_s
        if limit is None:
            return None
        megapixels = float(self.pixels.shape[0] * self.pixels.shape[1]) / 1e6
        return limit - RESERVE_S - RESERVE_S_PER_MEGAPIXEL * megapixels

    def source(self) -> NDArray[np.uint8]:
        """The picture at 8 bits, against which a result is measured."""
        levels: NDArray[np.uint8] = np.round(self.pixels * 255).astype(np.uint8)
        return levels

    def gaussians_asked(self) -> int:
        """The budget as a number of Gaussians. Raises BudgetError if it is more than pixels."""
        pixels = self.pixels.shape[0] * self.pixels.shape[1]
        if self.budget.value > pixels:
            raise BudgetError(f"{int(self.budget.value)} Gaussians are more than the image's {pixels} pixels")
        return int(self.budget.value)


@dataclass
class Parameters:
    """Gaussians as tensors: means [N, 2], factors [N, 3] (pixels), colors [N, 3]."""

    means: Tensor
    factors: Tensor
    colors: Tensor

    @classmethod
    def of(cls, gaussians: Gaussians) -> Parameters:
        """A copy of plain arrays."""
        return cls(*(torch.tensor(a) for a in (gaussians.means, gaussians.factors, gaussians.colors)))

    @classmethod
    def empty(cls, n: int) -> Parameters:
        """n Gaussians whose values are not set, for kernels to fill."""
        return cls(torch.empty(n, 2), torch.empty(n, 3), torch.empty(n, 3))

    def arrays(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """For kernels: (means, factors, colors), which share the tensors' memory where that is contiguous."""
        return self.means.contiguous().numpy(), self.factors.contiguous().numpy(), self.colors.contiguous().numpy()

    def numpy(self) -> Gaussians:
        """Plain Gaussians of the same arrays."""
        return Gaussians(*self.arrays())


class Picture:
    """The target with its loss; evaluates Gaussians and their gradients natively.

    A picture of half the size serves as well while Gaussians are few, at a quarter of the time: means and factors
    stay in pixels of the whole picture, and spacing says how many of those a pixel of this one is wide.
    """

    def __init__(self, image: FloatArray, lambda_g: float, cutoff: float = v1.CUTOFF, spacing: int = 1) -> None:
        """image [H, W, 3] in [0, 1]; lambda_g weighs the geometry-consistent regularisation; cutoff: sigma at
        which the weight of a Gaussian ends, by the version of the format."""
        self.target = torch.from_numpy(np.ascontiguousarray(image.transpose(2, 0, 1)))
        self.height, self.width = image.shape[:2]
        self.spacing = spacing
        self.lambda_g = lambda_g
        self.cutoff = cutoff
        self._loss = native.ReconstructionLoss(self.target.numpy(), lambda_g)
        self._image = torch.empty_like(self.target)
        self._grad = torch.empty_like(self.target)

    def halved(self) -> Picture:
        """The same picture at half the size."""
        planes = torch.nn.functional.pad(self.target[None], (0, self.width % 2, 0, self.height % 2), mode="replicate")
        small = torch.nn.functional.avg_pool2d(planes, 2)[0].permute(1, 2, 0).numpy()
        picture = Picture(small, self.lambda_g, self.cutoff, 2 * self.spacing)
        # Scratch is shared: pictures are evaluated one at a time.
        picture._image, picture._grad = (
            whole.view(-1)[: picture.target.numel()].view_as(picture.target) for whole in (self._image, self._grad)
        )
        return picture

    def rasterise(self, means: Tensor, factors: Tensor) -> native.Rasterization:
        """The geometry over this picture's pixels."""
        if self.spacing != 1:
            means, factors = means / self.spacing, factors / self.spacing
        arrays = means.contiguous().numpy(), factors.contiguous().numpy()
        return native.Rasterization(*arrays, self.width, self.height, self.cutoff)

    def gradients(self, p: Parameters) -> tuple[float, Parameters]:
        """Mean squared error, and the gradients of MSE + lambda_g L_g by each parameter."""
        raster = self.rasterise(p.means, p.factors)
        colors = p.colors.contiguous().numpy()
        out = Parameters.empty(len(p.means))
        if self.lambda_g == 0:
            mse = raster.squared_error(colors, self.target.numpy(), *out.arrays())
        else:
            image, grad = self._image.numpy(), self._grad.numpy()
            raster.render(colors, image)
            mse, _ = self._loss(image, grad)
            raster.backward(colors, grad, *out.arrays())
        if self.spacing != 1:
            out.means /= self.spacing
            out.factors /= self.spacing
        return mse, out

    def residual(self, p: Parameters) -> Tensor:
        """Target minus picture [3, H, W], in this picture's pixels; valid until gradients() is called."""
        self.rasterise(p.means, p.factors).render(p.colors.contiguous().numpy(), self._grad.numpy())
        return torch.sub(self.target, self._grad, out=self._grad)

    def interleaved(self, planes: Tensor) -> FloatArray:
        """Planes [3, H, W] of this picture's size as [H, W, 3], in memory of this picture: valid until it is drawn."""
        return self._image.view(self.height, self.width, 3).copy_(planes.permute(1, 2, 0)).numpy()

    def solve_colors(
        self, means: Tensor, factors: Tensor, steps: int, residual_of: Tensor | None = None, damping: float = 1e-2
    ) -> Tensor:
        """Colours [N, 3] near the least-squares solution for fixed geometry: the image is linear in them.

        Conjugate gradients from zero on the normal equations, preconditioned by the Gaussians' energies
        pi l1 l3, of which `damping` is added to the diagonal. The target is the picture, or residual_of [3, H, W].
        """
        raster, n = self.rasterise(means, factors), len(means)
        energy = (math.pi / self.spacing**2 * factors[:, :1] * factors[:, 2:]).clamp_min(1e-12)
        zero = np.zeros((n, 3), np.float32)
        by_means, by_factors, _ = Parameters.empty(n).arrays()

        def transpose(image: Tensor) -> Tensor:
            out = torch.empty(n, 3)
            raster.backward(zero, image.numpy(), by_means, by_factors, out.numpy())
            return out

        colors = torch.zeros(n, 3)
        residual = transpose(self.target if residual_of is None else residual_of)
        direction = z = residual / energy
        rz = (residual * z).sum(0)
        for _ in range(steps):
            raster.render(direction.numpy(), self._image.numpy())
            q = transpose(self._image) + damping * energy * direction
            alpha = rz / (direction * q).sum(0).clamp_min(1e-30)
            colors = colors + alpha * direction
            residual = residual - alpha * q
            z = residual / energy
            rz, previous = (residual * z).sum(0), rz
            direction = z + rz / previous.clamp_min(1e-30) * direction
        return colors


def add_energy_gradient(p: Parameters, grad: Parameters, weight: float) -> None:
    """Add the gradient of weight * sum |c|^2 pi l1 l3: what an error proportional to each colour would cost, and
    so a price on large colours that cancel each other."""
    area = math.pi * weight * p.factors[:, 0] * p.factors[:, 2]
    energy = p.colors.square().sum(1) * area
    grad.colors += 2 * p.colors * area[:, None]
    grad.factors[:, 0] += energy / p.factors[:, 0]
    grad.factors[:, 2] += energy / p.factors[:, 2]


class FrameAdam:
    """Adam on (d, S, colour), 8 numbers a Gaussian (see the module's text)."""

    def __init__(self, n: int, settings: OptimiserSettings) -> None:
        s = settings
        rates = (s.mean_rate, s.factor_rate, s.color_rate)
        self._settings = native.AdamSettings(*rates, s.beta1, s.beta2, s.min_scale_px)
        self.first, self.second = torch.zeros(n, 8), torch.zeros(n, 8)
        self.bias = torch.ones(n, 2)  # beta^steps; Gaussians that come later start their averages anew

    def select(self, index: Tensor) -> None:
        """Keep the Gaussians of these rows."""
        self.first, self.second, self.bias = self.first[index], self.second[index], self.bias[index]

    def extend(self, count: int) -> None:
        """Append new Gaussians."""
        self.first = torch.cat([self.first, torch.zeros(count, 8)])
        self.second = torch.cat([self.second, torch.zeros(count, 8)])
        self.bias = torch.cat([self.bias, torch.ones(count, 2)])

    def step(self, p: Parameters, grad: Parameters, rate: float) -> None:
        """Move p, in place, against its gradients; rate scales all rates."""
        moments = self.first.numpy(), self.second.numpy(), self.bias.numpy()
        # Not arrays(): a copy would move in p's place.
        native.frame_adam(
            self._settings, rate, p.means.numpy(), p.factors.numpy(), p.colors.numpy(), *grad.arrays(), *moments
        )


@dataclass(frozen=True)
class Plan:
    """One phase of an encode: its name in the trace, its steps, the second at which it must be over, and the part
    of it without progress after which it has converged."""

    phase: str
    steps: int
    until_s: float | None = None
    patience: float = 0.3


def run(
    plan: Plan, recorder: Recorder, step: Callable[[float, float], tuple[float, tuple[int, int]]], final_rate: float
) -> int:
    """Repeat step(rate, progress) -> (mse, counts); the rate falls along a cosine from 1 to final_rate.

    The schedule follows the steps or the time, whichever is further, so that a time limit shortens the
    schedule instead of cutting it off. Ends early when the error has stopped falling. Returns the steps done.
    """
    begun = recorder.clock.seconds()
    best, best_at, done = math.inf, 0.0, 0
    progress = 0.0
    while progress < 1:
        rate = final_rate + (1 - final_rate) * 0.5 * (1 + math.cos(math.pi * progress))
        mse, counts = step(rate, progress)
        done += 1
        progress = done / plan.steps
        if plan.until_s is not None:
            progress = max(progress, (recorder.clock.seconds() - begun) / max(plan.until_s - begun, 1e-9))
        recorder.report(plan.phase, done if progress < 1 else plan.steps, plan.steps, mse, counts)
        if mse < best * 10 ** (-PROGRESS_DB / 10):
            best, best_at = mse, progress
        elif progress - best_at > plan.patience:
            break
        if mse < PERFECT_MSE:
            break
    return done


def fit(
    picture: Picture, start: Gaussians, settings: Settings, recorder: Recorder, until_s: float | None
) -> tuple[Gaussians, int]:
    """Fitted Gaussians without any quantisation, and the steps that took."""
    p = Parameters.of(start)
    p.colors = picture.solve_colors(p.means, p.factors, settings.color_solve_steps)
    adam = FrameAdam(len(start), settings)

    def step(rate: float, _: float) -> tuple[float, tuple[int, int]]:
        mse, grad = picture.gradients(p)
        add_energy_gradient(p, grad, settings.lambda_e / picture.target.numel())
        adam.step(p, grad, rate)
        return mse, (len(start), 0)

    done = run(Plan("fit", settings.fit_steps, until_s), recorder, step, settings.final_rate)
    return p.numpy(), done
