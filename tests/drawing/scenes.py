"""Scenes on which every renderer is compared with the definition in float64."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from sgmethod.backend.protocol import Frame, Visibility
from sgmethod.native import native
from sgmethod.scene import FloatArray, Gaussians
from tests.backend.cases import single
from tests.definitions import drawing
from tests.definitions.backend import squared, weighted, with_coarse

TILE = native.TILE_WIDTH, native.TILE_HEIGHT

Size = tuple[int, int]
Range = tuple[float, float]
Exactly = NDArray[np.float64]


@dataclass(frozen=True)
class Scene:
    """Gaussians over a picture, and how it is drawn."""

    values: Gaussians
    size: Size
    pyramid: bool

    @property
    def cutoff(self) -> float:
        return native.CUTOFF_V2 if self.pyramid else native.MAX_CUTOFF

    @property
    def target(self) -> NDArray[np.int16]:
        image = np.random.default_rng(9).random((3, *self.size[::-1]))
        return np.round(image * native.TARGET_WHITE).astype(np.int16)

    @property
    def upstream(self) -> FloatArray:
        """A gradient by the picture [3, height, width]."""
        rng, shape = np.random.default_rng(9), (3, *self.size[::-1])
        rng.random(shape)
        return rng.standard_normal(shape).astype(np.float32)


def scattered(n: int, size: Size, l1: Range, l3: Range, shear: float) -> Gaussians:
    """n Gaussians in and around a picture; l1 and l3 log-uniform in pixels, l2 up to shear times l3."""
    rng = np.random.default_rng(n + 7 * size[0] + size[1])
    means = rng.uniform(-0.3, 1.3, (n, 2)) * size
    first, third = np.exp(rng.uniform(*np.log(l1), n)), np.exp(rng.uniform(*np.log(l3), n))
    factors = np.stack([first, rng.uniform(-shear, shear, n) * third, third], 1)
    return single(means, factors, rng.uniform(-1, 1, (n, 3)))


def on_centres(size: Size) -> Gaussians:
    """Thinner than pixels, with means within a tenth of a pixel of pixel centres."""
    thin = scattered(300, size, (0.01, 0.3), (0.01, 0.3), 3)
    means = np.floor(thin.means)
    return single(means + 0.5 + 0.1 * (thin.means - means - 0.5), thin.factors, thin.colors)


def of_every_level(size: Size) -> Gaussians:
    scale = 1.5 * drawing.NARROWEST * np.repeat(2.0 ** np.arange(drawing.MAX_LEVEL + 1), 3)
    rng, n = np.random.default_rng(1), len(scale)
    factors = np.stack([scale, rng.uniform(-0.2, 0.2, n) * scale, scale], 1)
    return single(rng.uniform(-0.2, 1.2, (n, 2)) * size, factors, rng.uniform(-1, 1, (n, 3)))


def at_thresholds(size: Size) -> Gaussians:
    """On both sides of where each level begins, round and slanted: the wrong level would be off by 2 %."""
    factors = []
    for level in range(1, 6):
        minor = drawing.NARROWEST * 2**level
        for side in (1 - 1e-6, 1 + 1e-6):
            factors += [[minor * side, 0, minor * side], turned(5 * minor, minor * side)]
    means = np.random.default_rng(0).uniform(0, 1, (len(factors), 2)) * size
    return single(means, factors, np.full((len(factors), 3), 0.7))


def turned(major: float, minor: float) -> list[float]:
    """The factor of an ellipse whose major axis lies at 45 degrees."""
    l1 = float(np.sqrt((major**2 + minor**2) / 2))
    return [l1, (major**2 - minor**2) / 2 / l1, major * minor / l1]


def needles(size: Size) -> Gaussians:
    """Of the largest slant that fits keep to, 2,048: they are at least 4,096 times as long as they are wide."""
    rng, n = np.random.default_rng(0), 12
    l3 = np.exp(rng.uniform(np.log(0.3), 0, n))
    l2 = rng.choice([-1, 1], n) * 2048 * l3
    l1 = np.abs(l2) * np.exp(rng.uniform(-1, 1, n))
    return single(rng.uniform(0.1, 0.9, (n, 2)) * size, np.stack([l1, l2, l3], 1), rng.uniform(-1, 1, (n, 3)))


def anywhere(n: int, size: Size, l1: Range, l3: Range, shear: float = 1, *, pyramid: bool = False) -> Scene:
    return Scene(scattered(n, size, l1, l3, shear), size, pyramid)


OUTSIDE = scattered(30, (20, 20), (1, 2), (1, 2), 1)
OUTSIDE.means[:] -= 500
SCENES = {
    "all sizes": anywhere(80, (100, 70), (0.3, 100), (0.3, 100)),
    "strong shear": anywhere(60, (75, 130), (0.3, 30), (0.3, 30), 30),
    "needles along x": anywhere(60, (90, 65), (5, 100), (0.3, 0.5)),
    "needles along y": anywhere(60, (90, 65), (0.3, 0.5), (5, 100)),
    "diagonal needles": anywhere(60, (90, 65), (5, 50), (0.3, 0.5), 100),
    "thinner than pixels": Scene(on_centres((24, 66)), (24, 66), pyramid=False),
    "specks": anywhere(400, (64, 64), (0.3, 1), (0.3, 1)),
    "whole tiles": anywhere(40, (2 * TILE[0], 2 * TILE[1]), (0.5, 20), (0.5, 20)),
    "one more than tiles": anywhere(40, (TILE[0] + 1, TILE[1] + 1), (1, 20), (1, 20)),
    "one pixel": anywhere(30, (1, 1), (0.3, 10), (0.3, 10)),
    "one row": anywhere(60, (4096, 1), (0.3, 100), (0.3, 100), 2),
    "one column": anywhere(60, (1, 4096), (0.3, 100), (0.3, 100), 2),
    "outside": Scene(OUTSIDE, (20, 20), pyramid=False),
    "none": anywhere(0, (33, 17), (1, 2), (1, 2)),
    "pyramid": anywhere(60, (83, 70), (0.4, 90), (0.4, 90), pyramid=True),
    "pyramid of several tiles": anywhere(60, (200, 131), (0.4, 90), (0.4, 90), pyramid=True),
    "pyramid on one pixel": anywhere(5, (1, 1), (0.4, 60), (0.4, 60), pyramid=True),
    "pyramid on one row": anywhere(10, (33, 1), (0.4, 60), (0.4, 60), pyramid=True),
    "narrow pyramid": anywhere(40, (5, 300), (0.4, 90), (0.4, 90), pyramid=True),
    "all levels": Scene(of_every_level((40, 30)), (40, 30), pyramid=True),
    "thresholds": Scene(at_thresholds((60, 60)), (60, 60), pyramid=True),
    "needles": Scene(needles((83, 70)), (83, 70), pyramid=True),
    "needles of several tiles": Scene(needles((200, 150)), (200, 150), pyramid=True),
    "none in a pyramid": anywhere(0, (33, 17), (1, 2), (1, 2), pyramid=True),
}
PYRAMIDS = [name for name, scene in SCENES.items() if scene.pyramid]
NEEDLES = ("needles", "needles of several tiles")
EMPTY = ("outside", "none", "none in a pyramid")


@dataclass(frozen=True)
class Exact:
    """What the definition draws, and its gradients from above by means, factors and colours."""

    picture: Exactly
    by_picture: list[Exactly]


@cache
def exact(name: str) -> Exact:
    leaves, picture = drawn(SCENES[name])
    upstream = torch.from_numpy(SCENES[name].upstream)
    return Exact(picture.detach().numpy(), gradients((picture * upstream).sum(), leaves))


def drawn(scene: Scene) -> tuple[list[Tensor], Tensor]:
    leaves = [torch.tensor(array, dtype=torch.float64, requires_grad=True) for array in scene.values.arrays]
    draw = drawing.render_pyramid if scene.pyramid else drawing.render
    return leaves, draw(leaves[0], leaves[1], leaves[2], scene.size, scene.cutoff)


def gradients(of: Tensor, leaves: list[Tensor]) -> list[Exactly]:
    if not len(leaves[0]):
        return [leaf.detach().numpy() for leaf in leaves]
    return [by.numpy() for by in torch.autograd.grad(of, leaves, retain_graph=True)]


@dataclass(frozen=True)
class ExactError:
    """The mean squared error from the target and its gradients, and half the derivative of the energy by colours."""

    error: float
    by_error: list[Exactly]
    gram: Exactly


def exact_error(scene: Scene, seen: Visibility | None) -> ExactError:
    leaves, picture = drawn(scene)
    errors = picture - torch.from_numpy(scene.target) / native.TARGET_WHITE
    counted = weighted(with_coarse(errors, Frame(*scene.size), seen), seen).detach() / errors.numel()
    alike = None if seen is None else Visibility(seen.values, by_eye=False)
    gram = gradients(squared(picture, alike) / 2, leaves)[2]
    return ExactError((errors * counted).sum().item(), gradients(2 * (errors * counted).sum(), leaves), gram)
