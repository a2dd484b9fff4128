"""LPIPS and DISTS, with weights from a seed: the real ones are not here, nor are their figures. Measures of local
statistics, on pictures whose value can be worked out by hand."""

from __future__ import annotations

import pickle
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import torch

from sgmethod.metrics.local import FIGURES, local_statistics
from sgmethod.metrics.perceptual import Networks, Pixels
from sgmethod.metrics.wasserstein import SPREAD, Wasserstein, distance, statistics
from tests.cli.test_cli import Run, in_folder, run
from tests.test_metrics import disturbed, picture

__all__ = ["in_folder", "run"]  # fixtures

ALEX = ((64, 3, 11), (192, 64, 5), (384, 192, 3), (256, 384, 3), (256, 256, 3))
VGG = (3, 64, 64, 128, 128, 256, 256, 256, 512, 512, 512, 512, 512, 512)
CHANNELS = 3 + 64 + 128 + 256 + 512 + 512
SOURCE = picture(80, 96)


@pytest.fixture(scope="module")
def weights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("weights")
    rng = np.random.default_rng(0)
    alex, vgg = {}, {}
    for i, (outputs, inputs, side) in enumerate(ALEX):
        alex[f"AlexNet_0.Conv_{i}.kernel"] = rng.normal(0, 1 / (inputs**0.5 * side), (outputs, inputs, side, side))
        alex[f"AlexNet_0.Conv_{i}.bias"] = np.zeros(outputs)
        alex[f"NetLinLayer_{i}.Conv_0.kernel"] = np.full((1, outputs, 1, 1), 0.1)
    for i, (inputs, outputs) in enumerate(pairwise(VGG)):
        vgg[f"VGG16_0.Conv_{i}.kernel"] = rng.normal(0, 1 / (3 * inputs**0.5), (outputs, inputs, 3, 3))
        vgg[f"VGG16_0.Conv_{i}.bias"] = np.zeros(outputs)
    for name, arrays in (("alexnet", alex), ("vgg16", vgg)):
        np.savez(folder / f"lpips_{name}.npz", **{key: value.astype(np.float32) for key, value in arrays.items()})
    torch.save({name: torch.ones(1, CHANNELS, 1, 1) for name in ("alpha", "beta")}, folder / "dists_alpha_beta.pt")
    return folder


def test_networks(weights: Path) -> None:
    networks = Networks(weights)
    same = networks(SOURCE, SOURCE)
    assert same == {"lpips": 0.0, "dists": pytest.approx(0, abs=1e-5)}
    little, more = (networks(disturbed(SOURCE, strength), SOURCE) for strength in (5, 60))
    assert 0 < little["lpips"] < more["lpips"]
    assert 0 < little["dists"] < more["dists"] < 1
    other = disturbed(SOURCE, 60)
    assert networks(SOURCE, other)["dists"] == pytest.approx(more["dists"], rel=1e-4)  # it has no direction
    assert networks.lpips(other, SOURCE) == pytest.approx(more["lpips"], rel=1e-5)


def test_compare_with_weights(run: Run, weights: Path, tmp_path: Path) -> None:
    ran = run("compare", "photo.png", "photo.png", "--weights", str(weights))
    assert [line.split() for line in ran.out.splitlines()[-2:]] == [["LPIPS", "0"], ["DISTS", ran.out.split()[-1]]]
    ran = run("compare", "photo.png", "photo.png", "--weights", str(tmp_path / "none"))
    assert ran.status == 2
    assert ran.err.startswith("sgmethod: cannot use the weights in ")


@pytest.mark.parametrize("name", ["lpips_vgg16.npz", "dists_alpha_beta.pt"])
def test_weights_of_something_else(weights: Path, tmp_path: Path, name: str) -> None:
    for path in weights.iterdir():
        (tmp_path / path.name).symlink_to(path)
    (tmp_path / name).unlink()
    if name.endswith("npz"):
        np.savez(tmp_path / name, something=np.zeros(3))
    else:
        (tmp_path / name).write_bytes(pickle.dumps(print, protocol=2))
    with pytest.raises(ValueError, match="has the wrong weights"):
        Networks(tmp_path)


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
    assert {found[name] for name in FIGURES if "luma" in name} == {1.0}
    assert found["spread_chroma_fine"] is None  # of a grey source
    half = local_statistics(grey(128 + noise / 2), grey(128 + noise))
    assert half["spread_luma_fine"] == pytest.approx(0.5, abs=0.01)
    assert half["kurtosis_luma_fine"] == pytest.approx(1, abs=0.05)
    peaks = np.where(rng.random((96, 144)) < 0.02, 127 * rng.choice([-1, 1], (96, 144)), 0)
    lonely = local_statistics(grey(128 + peaks), grey(128 + noise))
    assert lonely["kurtosis_luma_fine"] is not None
    assert lonely["kurtosis_luma_fine"] > 1.5  # 2.3 seen
