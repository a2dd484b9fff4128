"""Drawing and its gradients by plain operations on tensors, on any device of PyTorch.

Each Gaussian's ellipse is cut into rows, and each row into samples. This gives two lists of pairs, (Gaussian, row) and
(Gaussian, sample), with each Gaussian on its own level of the pyramid; every step is one operation on a whole list.
Values are those of tests/definitions/drawing.py, in the precision of the tensors. On devices without a fixed order of
summation, the last bits vary from run to run.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import torch
from torch import Tensor

from sgmethod.native import native

MAX_LEVEL, NARROWEST = native.MAX_LEVEL, native.NARROWEST
MAX_PAIRS = 1 << 22  # pairs of Gaussian and sample at a time: about 300 MB


@dataclass(frozen=True)
class _Samples:
    """Some pairs [P] of Gaussian and sample.

    z1, z2: the sample's position in the Gaussian's frame; e: exp(-sigma); weight: the sample's share of the colour.
    """

    gaussian: Tensor
    sample: Tensor
    z1: Tensor
    z2: Tensor
    e: Tensor
    weight: Tensor


class Pairs:
    """The samples that N Gaussians cover in a picture of size (width, height). Those not drawn have no gradient."""

    def __init__(self, means: Tensor, factors: Tensor, size: tuple[int, int], cutoff: float, pyramid: bool) -> None:
        drawn = is_drawn(means, factors)
        means = torch.where(drawn[:, None], means, 0)
        factors = torch.where(drawn[:, None], factors, factors.new_tensor([1, 0, 1]))
        self._cutoff, self._floor = cutoff, math.exp(-cutoff)
        level = _levels(factors) if pyramid else torch.zeros_like(drawn, dtype=torch.int64)
        self._shrink = torch.exp2(-level.to(means.dtype))
        self._p = p1, p2, p3 = (factors * self._shrink[:, None]).unbind(1)
        self._blur = blur = (1 - self._shrink**2).sqrt() / 2
        # Computed in ratios: squares of sizes, and products of two sizes, may overflow or vanish.
        ratio1 = (1 - (blur / p1) ** 2).sqrt()
        q1 = p1 * ratio1
        ratio3 = (1 - (blur / p3) ** 2 - (blur / p3 * (p2 / q1)) ** 2).sqrt()
        self._q = q1, p2 / ratio1, p3 * ratio3
        self._gain = 1 / (ratio1 * ratio3)
        self._mean = (means * self._shrink[:, None]).unbind(1)
        top = int(level.max()) if len(level) else 0
        self._sizes = [tuple(-(-side // 2**i) for side in size) for i in range(top + 1)]  # without borders
        self._places = [_places(sizes, border=min(i, 1)) for i, sizes in enumerate(self._sizes)]
        starts = [0]
        for width, height in self._widened():
            starts.append(starts[-1] + width * height)
        self._starts = starts
        self._find_rows(level, drawn)

    def _widened(self) -> list[tuple[int, int]]:
        """Sizes of the levels, including a border of one sample on all but the picture itself."""
        return [(width + 2 * min(i, 1), height + 2 * min(i, 1)) for i, (width, height) in enumerate(self._sizes)]

    def _find_rows(self, level: Tensor, drawn: Tensor) -> None:
        """List the pairs of Gaussian and row, each with its range of samples."""
        (q1, q2, q3), (x, y), border = self._q, self._mean, level.clamp_max(1)
        width, height = torch.tensor(self._sizes, device=level.device).T[:, level]
        spread = torch.hypot(q2, q3)
        first, count = _within(y, math.sqrt(2 * self._cutoff) * spread, height, border)
        self._gaussian, row = _spread(first, count * drawn)
        g = self._gaussian
        self._dy = row + 0.5 - y[g]
        z = self._dy / spread[g]
        half = q1[g] * (q3 / spread)[g] * (2 * self._cutoff - z * z).clamp_min(0).sqrt()
        self._column, self._count = _within(x[g] + q1[g] * (q2 / spread)[g] * z, half, width[g], border[g])
        starts = torch.tensor(self._starts, device=level.device)[level[g]]
        self._line = starts + (row + border[g]) * (width[g] + 2 * border[g]) + border[g]  # sample of column 0

    def _samples(self) -> Iterator[_Samples]:
        """Yield all pairs of Gaussian and sample in parts of bounded size."""
        ends, begin = self._count.cumsum(0), 0
        (q1, q2, q3), x = self._q, self._mean[0]
        while begin < len(ends):
            before = int(ends[begin - 1]) if begin else 0
            end = max(int(torch.searchsorted(ends, before + MAX_PAIRS, right=True)), begin + 1)
            part = slice(begin, end)
            row, column = _spread(self._column[part], self._count[part])
            g, line, dy = (values[part].index_select(0, row) for values in (self._gaussian, self._line, self._dy))
            z1 = (column + 0.5 - x.index_select(0, g)) / q1.index_select(0, g)
            z2 = (dy - q2.index_select(0, g) * z1) / q3.index_select(0, g)
            e = torch.exp(-(z1 * z1 + z2 * z2) / 2)
            yield _Samples(g, line + column, z1, z2, e, (e - self._floor).clamp_min(0))
            begin = end

    def draw(self, colors: Tensor) -> Tensor:
        """Draw the Gaussians with these colours [N, 3]: a picture [3, height, width]."""
        planes, strong = colors.new_zeros(3, self._starts[-1]), (colors * self._gain[:, None]).T.contiguous()
        for some in self._samples():
            for i, color in enumerate(strong):  # planes[i], because torch cannot differentiate several views at once
                planes[i].index_add_(0, some.sample, color.index_select(0, some.gaussian) * some.weight)
        image: Tensor | None = None
        for level in reversed(range(len(self._sizes))):
            here = self._level(planes, level)
            image = here if image is None else here + self._enlarged(image, level)
        assert image is not None
        return image

    def gradients(self, colors: Tensor, by_image: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Backpropagate a gradient by the picture [3, height, width] to means, factors and colours [N, 2 or 3]."""
        planes, strong = by_image.new_zeros(3, self._starts[-1]), (colors * self._gain[:, None]).T.contiguous()
        for level in range(len(self._sizes)):
            by_image = self._reduced(by_image, level - 1) if level else by_image
            self._level(planes, level)[:] = by_image
        sums = planes.new_zeros(8, len(colors))  # over samples: gradient times weight (3), z (2) and z z^T (3)
        for some in self._samples():
            by_weight = torch.zeros_like(some.weight)
            for total, plane, color in zip(sums, planes, strong, strict=False):
                by_sample = plane.index_select(0, some.sample)
                total.index_add_(0, some.gaussian, by_sample * some.weight)
                by_weight += by_sample * color.index_select(0, some.gaussian)
            by_weight *= some.e * (some.weight > 0)
            by_z1, by_z2 = by_weight * some.z1, by_weight * some.z2
            products = by_z1, by_z2, by_z1 * some.z1, by_z1 * some.z2, by_z2 * some.z2
            for total, values in zip(sums[3:], products, strict=True):
                total.index_add_(0, some.gaussian, values)
        return self._by_parameters(colors, sums)

    def _by_parameters(self, colors: Tensor, sums: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Turn sums over samples into gradients.

        The chain rule goes through z = L^-1 (p - mean), then through the narrowing on a level, where
        q1^2 = p1^2 - blur^2, q2 = p1 p2 / q1, q3^2 = p3^2 - blur^2 (1 + p2^2 / q1^2); the gain is p1 p3 / (q1 q3).
        """
        (p1, p2, p3), (q1, q2, q3), blur = self._p, self._q, self._blur
        a1, a2, b11, b12, b22 = sums[3:]
        by_means = torch.stack([a1 / q1 - q2 / q1 * (a2 / q3), a2 / q3], 1) * self._shrink[:, None]
        by_log_gain = (colors.T * sums[:3]).sum(0) * self._gain
        by_q1, by_q2, by_q3 = b11 / q1 - q2 / q1 * (b12 / q3), b12 / q3, b22 / q3 - by_log_gain / q3
        slope, v = p2 / q1, (blur / q1) ** 2
        slant = by_q3 * (blur / q1) * (blur / q3) * slope
        by_p1 = (by_q1 + slant * slope) * (p1 / q1) - (by_q2 * slope + by_log_gain / p1) * v
        by_p2, by_p3 = by_q2 * (p1 / q1) - slant, by_q3 * (p3 / q3) + by_log_gain / p3
        by_factors = torch.stack([by_p1, by_p2, by_p3], 1) * self._shrink[:, None]
        return by_means, by_factors, (sums[:3] * self._gain).T.contiguous()

    def _level(self, planes: Tensor, level: int) -> Tensor:
        """View of one level's samples [3, height, width], borders included, in `planes` of all levels."""
        width, height = self._widened()[level]
        return planes[:, self._starts[level] : self._starts[level + 1]].view(3, height, width)

    def _enlarged(self, image: Tensor, level: int) -> Tensor:
        """Enlarge the next level's samples to a level's (docs/format.md)."""
        for axis, (near, far) in zip((2, 1), self._places[level], strict=True):
            near, far = near.to(image.device), far.to(image.device)
            image = 0.75 * image.index_select(axis, near) + 0.25 * image.index_select(axis, far)
        return image

    def _reduced(self, image: Tensor, level: int) -> Tensor:
        """Transpose of enlarging: backpropagate a gradient by a level's samples to the next level's."""
        for axis, side, (near, far) in zip((2, 1), self._widened()[level + 1], self._places[level], strict=True):
            shape = [*image.shape]
            shape[axis] = side
            near, far, total = near.to(image.device), far.to(image.device), image.new_zeros(shape)
            image = total.index_add_(axis, near, image, alpha=0.75).index_add_(axis, far, image, alpha=0.25)
        return image


def is_drawn(means: Tensor, factors: Tensor) -> Tensor:
    """Mask [..., N] of Gaussians with positive l1 and l3, and with values that the tensors' precision can hold."""
    l1, l2, l3 = factors.unbind(-1)
    squares = torch.stack([l1 * l1, l3 * l3, l2 * l2 + l3 * l3], -1)
    normal = (squares >= torch.finfo(factors.dtype).tiny) & (squares < math.inf)
    finite = torch.cat([means, (l2 / (l1 * l3)).square()[..., None]], -1).isfinite()
    return (l1 > 0) & (l3 > 0) & normal.all(-1) & finite.all(-1)


def _levels(factors: Tensor) -> Tensor:
    """Highest level [N] on which each Gaussian's minor axis is at least NARROWEST samples long."""
    l1, l2, l3 = factors.unbind(1)
    a, c = l1 * l1, l2 * l2 + l3 * l3
    minor = 2 * a * l3 * l3 / (a + c + ((a - c) ** 2 + 4 * a * l2 * l2).sqrt())
    bounds = NARROWEST**2 * 4.0 ** torch.arange(1, MAX_LEVEL + 1, dtype=minor.dtype, device=minor.device)
    return (minor[:, None] >= bounds).sum(1)


def _within(center: Tensor, half: Tensor, side: Tensor, border: Tensor) -> tuple[Tensor, Tensor]:
    """First sample within `half` of a center, and their number, among samples -border to side + border - 1."""
    first = torch.minimum(torch.maximum((center - half - 0.5).ceil(), -border), side + border)
    last = torch.minimum(torch.maximum((center + half - 0.5).floor(), -border - 1), side + border - 1)
    return first.long(), (last - first + 1).clamp_min(0).long()


def _spread(first: Tensor, count: Tensor) -> tuple[Tensor, Tensor]:
    """Pair each index i with first[i], first[i] + 1, ..., count[i] numbers in all."""
    index = torch.repeat_interleave(count)
    start = count.cumsum(0) - count
    return index, torch.arange(len(index), device=count.device) + (first - start).index_select(0, index)


def _places(size: tuple[int, ...], border: int) -> list[tuple[Tensor, Tensor]]:
    """Indices, along x and y, of the two samples of the next level (border included) that enlarge to each sample."""
    axes = [torch.arange(-border, side + border) for side in size]
    near = [axis.div(2, rounding_mode="floor") for axis in axes]
    return [(n + 1, n + 1 + torch.where(axis % 2 == 1, 1, -1)) for n, axis in zip(near, axes, strict=True)]
