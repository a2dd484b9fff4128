"""The compiled kernels as a backend."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from sgmethod.backend.protocol import (
    GRID_REACH,
    Coding,
    Descent,
    Frame,
    Moments,
    RefineLimits,
    Target,
    Visibility,
)
from sgmethod.native import native
from sgmethod.scene import FloatArray, Gaussians

Loss = Callable[[Gaussians], tuple[float, Gaussians]]


class Kernels:
    """A Backend on all threads of the CPU, with the same results for every number of threads."""

    def residual(
        self, gaussians: Gaussians, frame: Frame, target: Target, first_row: int = 0, *, half: bool = False
    ) -> FloatArray:
        _, height, width = target.shape
        missing = np.empty((3, -(-height // 2), -(-width // 2)) if half else target.shape, np.float32)
        raster = _raster(gaussians, frame, height, first_row)
        fill = raster.missing_halved if half else raster.missing
        fill(gaussians.colors, np.ascontiguousarray(target), missing)
        return missing

    def error(self, gaussians: Gaussians, frame: Frame, target: Target, visibility: Visibility | None = None) -> float:
        if visibility is not None:
            return self.gradients(gaussians, frame, target, visibility)[0]
        return _raster(gaussians, frame).error(gaussians.colors, target)

    def gradients(
        self, gaussians: Gaussians, frame: Frame, target: Target, visibility: Visibility | None = None
    ) -> tuple[float, Gaussians]:
        out = Gaussians.empty(len(gaussians))
        mse = _raster(gaussians, frame).squared_error(
            gaussians.colors, target, *out.arrays, *_weights(visibility), frame.spacing
        )
        return mse, _by_whole_pixels(out, frame)

    def regularised(self, frame: Frame, image: FloatArray, lambda_g: float) -> Loss:
        """Build the loss MSE + lambda_g L_g (paper, section III-D) against image [3, H, W].

        The returned function of Gaussians gives the MSE and the gradient of the sum.
        """
        loss = native.ReconstructionLoss(image, lambda_g)
        drawn, by_image = np.empty_like(image), np.empty_like(image)

        def evaluate(gaussians: Gaussians) -> tuple[float, Gaussians]:
            raster, out = _raster(gaussians, frame), Gaussians.empty(len(gaussians))
            raster.render(gaussians.colors, drawn)
            mse = loss(drawn, by_image)
            raster.backward(gaussians.colors, by_image, *out.arrays)
            return mse, _by_whole_pixels(out, frame)

        return evaluate

    def gram(self, gaussians: Gaussians, frame: Frame, visibility: Visibility | None = None) -> FloatArray:
        product = np.empty_like(gaussians.colors)
        _raster(gaussians, frame).gram(gaussians.colors, product, None if visibility is None else visibility.values)
        return product

    def step(self, gaussians: Gaussians, gradient: Gaussians, moments: Moments, descent: Descent, rate: float) -> None:
        """Move Gaussians in place by one step of Adam in each one's own frame, and update the moments.

        A mean moves by L d and a factor by L S with S lower triangular, so a rate is the same relative change for a
        speck and for a wide ellipse. A step is at most settings.newton_steps times the Gauss-Newton step with a
        diagonal matrix, whose curvature grows with the visibility at the centre, if that is above 1, and with the part
        of the Gaussian that coarse errors count once more. rate: factor on all rates of the settings.
        """
        weights, _, coarse = _weights(descent.visibility)
        arrays = *gaussians.arrays, *gradient.arrays, moments.first, moments.second, moments.bias
        native.frame_adam(_adam(descent), rate, *arrays, weights, descent.frame.spacing, coarse)

    def add_rate_gradient(self, gaussians: Gaussians, gradient: Gaussians, quantum: float, weight: float) -> None:
        """Add, in place, the gradient of `weight` times a smooth estimate of all Gaussians' bits.

        The estimate is log2(1 + |value| / step) of each coded value, and log2(1 + m) for the size and for both
        coordinates, where m is the colour's length in steps.
        """
        values = gaussians.factors, gaussians.colors, gradient.factors, gradient.colors
        native.rd_rate_gradient(quantum, weight, *values)

    def keep_in_range(self, gaussians: Gaussians, width: int, height: int) -> None:
        native.keep_in_range(GRID_REACH, width, height, *gaussians.arrays)

    def steps(self, gaussians: Gaussians, moments: Moments, descent: Descent, rates: Sequence[float]) -> list[float]:
        d, f = descent, descent.frame
        visibility, by_eye, coarse = _weights(d.visibility)
        return native.rd_steps(
            target=d.target,
            cutoff=f.cutoff,
            pyramid=f.pyramid,
            spacing=f.spacing,
            quantum=d.quantum,
            price=d.price,
            settings=_adam(d),
            rates=np.array(rates, np.float32),
            reach=GRID_REACH,
            width=d.width,
            height=d.height,
            means=gaussians.means,
            factors=gaussians.factors,
            colors=gaussians.colors,
            first=moments.first,
            second=moments.second,
            bias=moments.bias,
            visibility=visibility,
            by_eye=by_eye,
            coarse=coarse,
        )

    def rounded(self, gaussians: Gaussians, coding: Coding) -> Gaussians:
        out = Gaussians.empty(len(gaussians))
        native.rd_quantise(coding.parameters, *gaussians.arrays, *out.arrays)
        return out

    def refine(
        self, gaussians: Gaussians, coding: Coding, target: Target, limits: RefineLimits, visibility: Visibility | None
    ) -> bytes:
        values, by_eye, _ = _weights(visibility)
        return native.rd_refine(
            coding.parameters,
            *gaussians.arrays,
            target,
            price=limits.price,
            sweeps=limits.sweeps,
            seconds=limits.seconds,
            max_bytes=limits.max_bytes,
            visibility=values,
            by_eye=by_eye,
            halvings=limits.spacing.bit_length() - 1,
        )


def _adam(descent: Descent) -> native.AdamSettings:
    s = descent.settings
    rates = s.mean_rate, s.factor_rate, s.color_rate
    return native.AdamSettings(*rates, s.beta1, s.beta2, s.min_scale_px, s.newton_steps, descent.values)


def _raster(gaussians: Gaussians, frame: Frame, rows: int | None = None, first_row: int = 0) -> native.Rasterization:
    means, factors = gaussians.means, gaussians.factors
    if frame.spacing != 1:
        means, factors = means / np.float32(frame.spacing), factors / np.float32(frame.spacing)
    size = frame.width, frame.height if rows is None else rows
    return native.Rasterization(means, factors, *size, cutoff=frame.cutoff, pyramid=frame.pyramid, y=first_row)


def _by_whole_pixels(gradient: Gaussians, frame: Frame) -> Gaussians:
    if frame.spacing != 1:
        for values in (gradient.means, gradient.factors):
            np.divide(values, np.float32(frame.spacing), out=values)
    return gradient


def _weights(visibility: Visibility | None) -> tuple[NDArray[np.int16] | None, bool, float]:
    return (None, True, 0.0) if visibility is None else (visibility.values, visibility.by_eye, visibility.coarse)
