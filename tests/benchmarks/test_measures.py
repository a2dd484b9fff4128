"""Wasserstein Distortion and local statistics, on pictures whose value can be worked out by hand."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import torch

from benchmarks.perceptual.local import FIGURES, Pixels, local_statistics
from benchmarks.perceptual.wasserstein import SPREAD, Wasserstein, distance, statistics
from tests.benchmarks.test_perceptual import VGG

BOARD = torch.from_numpy(np.indices((2, 24, 24)).sum(0) % 2 * 2.0 - 1)  # of -1 and 1


def grey(level: float | np.ndarray) -> Pixels:
    return np.repeat(np.broadcast_to(np.round(level), (96, 144))[..., None], 3, axis=2).astype(np.uint8)


@pytest.mark.parametrize("log2_sigma", [0, 1, 3])
def test_wasserstein_distortion_of_features_by_hand(log2_sigma: int) -> None:
    """Means and deviations at once: the window sees as much of a board's black as of its white."""
    flat = torch.ones_like(BOARD)
    cases = [
        (3 * flat, 5 * flat, 4.0),  # another level: (5 - 3)^2
        (BOARD, -BOARD, 4.0 if log2_sigma == 0 else 0.0),  # grain in other places
        (BOARD, 4 * BOARD, 9.0),  # grain of other strength: (4 - 1)^2
        (2 * flat, 5 * flat + BOARD, 10.0),  # 3^2 + 1^2
    ]
    for one, other, wanted in cases:
        found = distance(statistics(one, log2_sigma), statistics(other, log2_sigma))
        assert found == pytest.approx(wanted, abs=1e-5)


def test_wasserstein_distortion_of_pictures_by_hand(tmp_path: Path) -> None:
    """By a network that hands colours on: each of the four features then has the same distance."""
    arrays = {}
    for i, (inputs, outputs) in enumerate(pairwise(VGG)):
        kernel = np.zeros((outputs, inputs, 3, 3), np.float32)
        kernel[range(outputs), np.arange(outputs) % min(inputs, 3), 1, 1] = 1
        arrays[f"VGG16_0.Conv_{i}.kernel"] = kernel
        arrays[f"VGG16_0.Conv_{i}.bias"] = np.full(outputs, 5.0 if i == 0 else 0.0, np.float32)  # above any ReLU
    np.savez(tmp_path / "lpips_vgg16.npz", **arrays)
    measure = Wasserstein(tmp_path)
    light, dark = (np.full((64, 64, 3), level, np.uint8) for level in (151, 100))
    assert measure(dark, dark) == 0
    shares = np.array([[(np.arange(n) % 3 == k).mean() for k in range(3)] for n in (64, 128, 256, 512)])
    wanted = (shares * (51 / 255 / np.array(SPREAD)) ** 2).sum()
    assert measure(light, dark) == pytest.approx(wanted, rel=1e-4)


def test_local_statistics() -> None:
    """Half the contrast is half the spread. Few high peaks in place of noise are the same spread, and more kurtosis."""
    rng = np.random.default_rng(0)
    noise = rng.normal(0, 20, (96, 144))
    found = local_statistics(grey(128 + noise), grey(128 + noise))
    assert {name: found[name] for name in FIGURES if "luma" in name} == dict.fromkeys(
        (name for name in FIGURES if "luma" in name), 1.0
    )
    assert found["spread_chroma_fine"] is None  # of a grey source
    half = local_statistics(grey(128 + noise / 2), grey(128 + noise))
    assert half["spread_luma_fine"] == pytest.approx(0.5, abs=0.01)
    assert half["kurtosis_luma_fine"] == pytest.approx(1, abs=0.05)
    peaks = np.where(rng.random((96, 144)) < 0.02, 127 * rng.choice([-1, 1], (96, 144)), 0)
    lonely = local_statistics(grey(128 + peaks), grey(128 + noise))
    assert lonely["kurtosis_luma_fine"] is not None
    assert lonely["kurtosis_luma_fine"] > 1.5  # 2.3 seen
