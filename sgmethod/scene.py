"""Scenes: a set of Gaussians, and everything else that drawing them needs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
from numpy.typing import NDArray

from sgmethod.numerics import quiet

FloatArray = NDArray[np.float32]
Pixels = NDArray[np.uint8]


@dataclass(frozen=True, eq=False)
class Gaussians:
    """N Gaussians over a picture.

    means [N, 2]: centres (x, y) in pixels, the first pixel's centre at (0.5, 0.5);
    factors [N, 3]: (l1, l2, l3) in pixels of the lower triangular L, covariance = L L^T;
    colors [N, 3]: signed RGB weights, 1 being full white.

    Two objects are equal if all their values are equal. They have no hash, since their arrays may change.
    """

    means: FloatArray
    factors: FloatArray
    colors: FloatArray

    if TYPE_CHECKING:  # what pack() and its like convert

        def __init__(self, means: npt.ArrayLike, factors: npt.ArrayLike, colors: npt.ArrayLike) -> None: ...

    def __len__(self) -> int:
        return len(self.means)

    __hash__ = None  # type: ignore[assignment]

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Gaussians):
            return NotImplemented
        pairs = zip(self.arrays, other.arrays, strict=True)
        return all(np.array_equal(readable(one), readable(another)) for one, another in pairs)

    @classmethod
    def empty(cls, n: int) -> Gaussians:
        """Allocate n Gaussians with uninitialised values."""
        return cls(*(np.empty((n, width), np.float32) for width in (2, 3, 3)))

    @classmethod
    @quiet
    def from_covariances(cls, means: npt.ArrayLike, covariances: npt.ArrayLike, colors: npt.ArrayLike) -> Gaussians:
        """Build Gaussians from covariances [N, 2, 2] in pixels squared; factors are NaN unless positive definite."""
        (xx, xy), (_, yy) = np.moveaxis(np.asarray(covariances, np.float64), 0, -1)
        l1 = np.sqrt(xx)
        factors = np.stack([l1, xy / l1, np.sqrt(yy - (xy / l1) ** 2)], 1)
        return cls(*(np.asarray(values, np.float32) for values in (means, factors, colors)))

    @property
    @quiet
    def covariances(self) -> FloatArray:
        """Covariances [N, 2, 2] in pixels squared."""
        l1, l2, l3 = self.factors.T
        return np.stack([l1 * l1, l1 * l2, l1 * l2, l2 * l2 + l3 * l3], 1).reshape(-1, 2, 2)

    @property
    def arrays(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """The tuple (means, factors, colors)."""
        return self.means, self.factors, self.colors

    def copy(self) -> Gaussians:
        """Return a deep copy."""
        return Gaussians(*(values.copy() for values in self.arrays))

    def rows(self, index: NDArray[np.intp] | NDArray[np.bool_]) -> Gaussians:
        """Return the Gaussians at `index`, in its order."""
        return Gaussians(*(values[index] for values in self.arrays))

    def with_more(self, new: Gaussians) -> Gaussians:
        """Return these Gaussians followed by new ones."""
        return Gaussians(*(np.concatenate(pair) for pair in zip(self.arrays, new.arrays, strict=True)))


def readable(values: Any) -> Any:
    """Return a tensor of any device and type as one that NumPy, without bfloat16, reads; other values as they are."""
    return values.detach().cpu().double() if hasattr(values, "detach") else values


@dataclass(frozen=True)
class Texture:
    """Noise from a seed, drawn together with the Gaussians (docs/format.md, version 2).

    codes [octaves, rows, columns]: strengths at the centres of the picture's cells, 0 for none;
    cell: sides (x, y) of a cell; corner: the picture's corner (x, y), in the coordinates of the means;
    shift: octave o is drawn on level o + shift of the pyramid, or not at all below level 0.
    """

    codes: NDArray[np.uint8]
    cell: tuple[float, float]
    corner: tuple[float, float] = (0.0, 0.0)
    shift: int = 0


@dataclass(frozen=True)
class Scene:
    """Everything needed to draw a picture, the same for every version of the file format.

    width, height: pixels; background: 8-bit RGB, below all Gaussians; cutoff: sigma at which a Gaussian ends;
    pyramid: whether wide Gaussians are drawn on coarser levels (docs/format.md, version 2); origin: the first pixel
    (x, y) drawn, in the coordinates of the means; texture: only with a pyramid; alpha: a grey scene of the same size,
    white where the picture is opaque.
    """

    gaussians: Gaussians
    width: int
    height: int
    background: tuple[int, int, int]
    cutoff: float
    pyramid: bool = False
    origin: tuple[int, int] = (0, 0)
    texture: Texture | None = None
    alpha: Scene | None = None
