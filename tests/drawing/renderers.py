"""What draws and differentiates in numbers; and by how much each may be off, with the worst error seen."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
import torch
from numpy.typing import NDArray

from sgmethod.backend.protocol import Frame
from sgmethod.native import ISAS, native
from sgmethod.torch.pairs import Pairs
from tests.drawing.scenes import Scene

Array = NDArray[np.floating]
# A picture [3, height, width], and its gradients from above by means, factors and colours.
Drawn = tuple[Array, Sequence[Array]]


def rasterised(scene: Scene, isa: int) -> native.Rasterization:
    means, factors, _ = scene.values.arrays
    return native.Rasterization(means, factors, *scene.size, scene.cutoff, isa, pyramid=scene.pyramid)


def by_kernels(isa: int, scene: Scene) -> Drawn:
    raster, colors = rasterised(scene, isa), scene.values.colors
    picture = np.full((3, *scene.size[::-1]), np.nan, np.float32)
    raster.render(colors, picture)
    gradients = [np.full_like(array, np.nan) for array in scene.values.arrays]
    raster.backward(colors, scene.upstream, *gradients)
    return picture, gradients


def by_pairs(dtype: torch.dtype, scene: Scene) -> Drawn:
    arrays = *scene.values.arrays, scene.upstream
    means, factors, colors, upstream = (torch.from_numpy(array).to(dtype) for array in arrays)
    pairs = Pairs(means, factors, scene.size, scene.cutoff, scene.pyramid)
    return pairs.draw(colors).numpy(), [by.numpy() for by in pairs.gradients(colors, upstream)]


def by_tiles(scene: Scene) -> Drawn:
    from sgmethod.torch.tiles import Tiles  # which needs Triton

    means, factors, colors, upstream = (
        torch.from_numpy(array)[None] for array in (*scene.values.arrays, scene.upstream)
    )
    tiles = Tiles(Frame(*scene.size, scene.cutoff, scene.pyramid), means, factors, colors)
    return tiles.draw()[0].numpy(), [by[0].numpy() for by in tiles.gradients(upstream)]


# Errors are absolute in the picture, 1 being full white, and in parts of the largest of its kind in a gradient.
RENDERERS: dict[str, tuple[Callable[[Scene], Drawn], float]] = {
    f"kernels, {name}": (partial(by_kernels, isa), 1e-5)  # worst seen 7.8e-6 and 5.5e-6
    for isa, name in enumerate(ISAS[: native.best_isa() + 1])
}
RENDERERS["pairs"] = partial(by_pairs, torch.float64), 1e-9
RENDERERS["pairs in single precision"] = partial(by_pairs, torch.float32), 2e-5  # worst seen 9.5e-6 and 3.7e-6
if os.environ.get("TRITON_INTERPRET"):  # tests/torch/test_tiles.py
    RENDERERS["tiles"] = by_tiles, 1e-5  # worst seen 6.2e-6 and 1.6e-6
