"""Drawing, gradients and the optimiser for batches on a GPU, by the Triton kernels of tile_kernels.py.

The values are the same as in pairs.py, in single precision. To draw, each Gaussian is listed for the tiles of
its level that its ellipse meets; one program sums the list of a tile, then adds the next level, enlarged. To
differentiate, one program walks along the ellipse of a Gaussian and keeps its sums. The order of both sums is fixed.
The lists have room for PAIRS tiles per Gaussian, on average. Gaussians for which the lists have no room are added by
atomic operations.

Nothing is read back: sizes of all tensors follow from the number of Gaussians and the size of the picture.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import torch
from torch import Tensor

from sgmethod.backend.protocol import Descent, Frame
from sgmethod.torch import tile_kernels
from sgmethod.torch.pairs import MAX_LEVEL
from sgmethod.torch.tile_kernels import RECORD, TILE

PAIRS = 8  # tiles listed per Gaussian, on average; a round one meets at most 4 on its level
ALIGNED = 16  # samples: pointers to levels are alike, so that kernels are compiled once
BLOCK = 128  # Gaussians of a program where each is a lane


@dataclass(frozen=True)
class _Grid:
    """The samples and tiles of a level. start, tile: its first sample and tile in a picture; sizes are with borders."""

    start: int
    tile: int
    width: int
    height: int
    border: int

    @property
    def area(self) -> int:
        return self.width * self.height

    @property
    def across(self) -> int:
        return -(-self.width // TILE)

    @property
    def tiles(self) -> int:
        return self.across * -(-self.height // TILE)


class Tiles:
    """B pictures of N Gaussians each, to draw in a frame: means [B, N, 2], factors and colours [B, N, 3] in float32.

    Gaussians whose values cannot be drawn, as zeros that fill up a picture, draw nothing and have no gradient.
    """

    def __init__(self, frame: Frame, means: Tensor, factors: Tensor, colors: Tensor) -> None:
        self._values = tuple(values.contiguous() for values in (means, factors, colors))
        self._frame, self._device = frame, means.device
        self._batch, self._each = means.shape[:2]
        self._total = self._batch * self._each
        self._levels, self._table = _layout(frame.width, frame.height, frame.pyramid, means.device)
        last = self._levels[-1]
        self._samples, self._tiles = last.start + last.area, last.tile + last.tiles  # of a picture, on all levels
        self._reach, self._floor, self._scale = math.sqrt(2 * frame.cutoff), math.exp(-frame.cutoff), 1 / frame.spacing
        self._level, self._counts = (self._new(self._total, dtype=torch.int32) for _ in range(2))
        self._records = self._new(self._total, RECORD)
        self._ends, self._keys = self._counts, self._new(0, dtype=torch.int64)
        self._assign(lists=False)

    def draw(self) -> Tensor:
        """Draw the pictures [B, 3, height, width]."""
        return self._plane(self._drawn(None), 0)

    def gradients(self, by_image: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Backpropagate a gradient by the pictures to means, factors and colours."""
        planes = self._new(self._batch * 3 * self._samples)
        self._plane(planes, 0).copy_(by_image)
        sums, out = self._sums(planes), tuple(torch.empty_like(values) for values in self._values)
        values = *self._values, sums, *out, self._total, self._scale, self._frame.pyramid
        self._launch(tile_kernels.gradients, self._blocks(), *values, BLOCK)
        return out  # type: ignore[return-value]

    def step(
        self, moments: Sequence[Tensor], bits: Sequence[Tensor], target: Tensor, descent: Descent, rate: float
    ) -> None:
        """Take a step of the optimiser, in place, as Backend does.

        Means, factors and colours must be contiguous; zeros fill up pictures with fewer Gaussians, and stay.
        moments: first and second [B, N, 8] and bias [B, N, 2], as of protocol.Moments; target: [B, 3, height, width].
        bits: quanta and prices [B], as of `descent`, whose other fields are alike for all pictures.
        """
        planes, s = self._drawn(target.contiguous()), descent.settings
        means, factors, colors = self._values
        first, second, bias = moments
        quanta, prices = bits
        self._launch(
            tile_kernels.step,
            self._blocks(),
            means=means,
            factors=factors,
            colors=colors,
            sums=self._sums(planes),
            first=first,
            second=second,
            bias=bias,
            quanta=quanta,
            prices=prices,
            total=self._total,
            each=self._each,
            scale=self._scale,
            mean_rate=rate * s.mean_rate,
            factor_rate=rate * s.factor_rate,
            color_rate=rate * s.color_rate,
            beta1=s.beta1,
            beta2=s.beta2,
            least=s.min_scale_px,
            newton=s.newton_steps * descent.values / (2 * math.pi),
            width=float(descent.width),
            height=float(descent.height),
            pyramid=self._frame.pyramid,
            block=BLOCK,
        )

    def _drawn(self, target: Tensor | None) -> Tensor:
        """Planes of all levels; the finest has the pictures or, given a target, the gradient of the error by them."""
        starts = self._list()
        planes = torch.zeros(self._batch * 3 * self._samples, device=self._device)
        self._walk(planes, self._records, draws=True)
        for k, level in reversed([*enumerate(self._levels)]):
            compares, enlarges = target is not None and k == 0, k + 1 < len(self._levels)
            above = k + 1 if enlarges else k
            coarse, here, coarser = self._levels[above], self._plane(planes, k), self._plane(planes, above)
            tensors = here, coarser, here if target is None else target, self._records, self._keys, starts
            sizes = level.across, level.width, level.height, level.border, coarse.width, level.area, coarse.area
            numbers = self._tiles, level.tile, *sizes, self._floor, 2 / (3 * self._levels[0].area)
            self._launch(tile_kernels.draw, (level.tiles, self._batch), *tensors, *numbers, enlarges, compares)
        return planes

    def _list(self) -> Tensor:
        """List the pairs of tile and Gaussian in order; return where each tile's begin, and the last one's end."""
        self._ends = self._counts.cumsum(0)
        self._keys = torch.full((self._total * PAIRS,), torch.iinfo(torch.int64).max, device=self._device)
        self._assign(lists=True)
        self._keys = self._keys.sort().values
        return torch.searchsorted(self._keys, torch.arange(self._batch * self._tiles + 1, device=self._device) << 32)

    def _assign(self, lists: bool) -> None:
        tensors = *self._values, self._table, self._level, self._records, self._counts, self._ends, self._keys
        numbers = self._total, self._each, self._tiles, len(self._keys), self._reach, self._scale
        self._launch(tile_kernels.assign, self._blocks(), *tensors, *numbers, self._frame.pyramid, lists, BLOCK)

    def _sums(self, planes: Tensor) -> Tensor:
        """Sum over each Gaussian's samples, given planes with the gradient by the pictures."""
        for k, (fine, coarse) in enumerate(zip(self._levels, self._levels[1:], strict=False)):
            sizes = coarse.across, fine.width, fine.height, fine.border, coarse.width, coarse.height
            pair = self._plane(planes, k), self._plane(planes, k + 1)
            self._launch(tile_kernels.reduce, (coarse.tiles, self._batch), *pair, *sizes)
        sums = self._new(self._total, RECORD)
        self._walk(planes, sums, draws=False)
        return sums

    def _walk(self, planes: Tensor, sums: Tensor, draws: bool) -> None:
        tensors = planes, self._table, self._level, self._records, self._ends, sums
        numbers = self._each, self._batch, len(self._keys), self._reach, self._floor
        self._launch(tile_kernels.walk, (self._total,), *tensors, *numbers, draws, num_warps=1)

    def _plane(self, planes: Tensor, k: int) -> Tensor:
        """Samples [B, 3, height, width] of a level."""
        level = self._levels[k]
        shape = self._batch, 3, level.height, level.width
        first = self._batch * 3 * level.start
        return planes[first : first + math.prod(shape)].view(shape)

    def _blocks(self) -> tuple[int]:
        return (-(-self._total // BLOCK),)

    def _new(self, *shape: int, dtype: torch.dtype = torch.float32) -> Tensor:
        return torch.empty(shape, dtype=dtype, device=self._device)

    def _launch(self, kernel: Any, grid: tuple[int, ...], *arguments: object, **options: object) -> None:
        if math.prod(grid) == 0:
            return
        with torch.cuda.device(self._device) if self._device.type == "cuda" else nullcontext():
            kernel[grid](*arguments, enable_fp_fusion=True, **options)


@lru_cache(maxsize=64)
def _layout(width: int, height: int, pyramid: bool, device: torch.device) -> tuple[tuple[_Grid, ...], Tensor]:
    """Levels of a picture; and for the kernels first sample, size without border, first tile and tiles in a row."""
    levels: list[_Grid] = []
    start = tile = 0
    for k in range(MAX_LEVEL + 1 if pyramid else 1):
        border = min(k, 1)
        level = _Grid(start, tile, -(-width // 2**k) + 2 * border, -(-height // 2**k) + 2 * border, border)
        levels.append(level)
        start, tile = -(-(start + level.area) // ALIGNED) * ALIGNED, tile + level.tiles
    rows = [[at.start, at.width - 2 * at.border, at.height - 2 * at.border, at.tile, at.across] for at in levels]
    return tuple(levels), torch.tensor(rows, dtype=torch.int32, device=device)
