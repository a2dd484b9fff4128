"""The strengths of texture against their definition, and the pictures that get none."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from sgmethod.fitting.objective import Objective
from sgmethod.fitting.texture import BLOCK, SIDE, STEPS, TINY, _strengths
from sgmethod.settings.rd import RD

SETTINGS = RD.objective.texture


def between(count: int) -> NDArray[np.float64]:
    """Linear interpolation from cells to their blocks, constant beyond the outer cells' centres, as a matrix."""
    at = np.clip((np.arange(count * SIDE) + 0.5) / SIDE - 0.5, 0, count - 1)
    return np.maximum(1 - np.abs(at[:, None] - np.arange(count)), 0)


@pytest.mark.parametrize("cells", [(1, 1), (1, 9), (9, 1), (2, 3), (6, 5)])
def test_strengths_fit_the_blocks_through_the_decoders_interpolation(cells: tuple[int, int]) -> None:
    rows, columns = cells
    random = np.random.default_rng(3)
    blocks = (rows * SIDE, columns * SIDE)
    spread = (random.uniform(1, 9, blocks) * (random.random(blocks) > 0.1)).astype(np.float32)
    down, across = between(rows), between(columns)
    cell = spread.reshape(rows, SIDE, columns, SIDE)
    least = np.quantile(cell.transpose(0, 2, 1, 3).reshape(rows, columns, -1), SETTINGS.quantile, axis=2)
    expected = least.astype(np.float64)
    for _ in range(STEPS):
        shown = down @ expected @ across.T
        weights = np.where(shown > spread, SETTINGS.excess, 1.0)
        expected *= (down.T @ (weights * spread) @ across) / (down.T @ (weights * shown) @ across + TINY)
    assert expected.max() > 1
    np.testing.assert_allclose(_strengths(spread, SETTINGS), expected, rtol=1e-12)  # seen: 8e-16


@pytest.mark.parametrize("thin", [1, BLOCK - 1, BLOCK])
def test_strips_thinner_than_a_block_get_none(thin: int) -> None:
    """A long one would be padded to many times its size."""
    for size in ((thin, 100), (100, thin)):
        objective = Objective.from_pixels(np.zeros((*size, 3), np.uint8), "visual", RD.objective)
        target = objective.moving_target(np.zeros((3, *size), np.int16), 1, 0)
        assert (objective.replaces_grain, target.hides) == (thin == BLOCK, thin != BLOCK)
