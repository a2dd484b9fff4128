"""LPIPS and DISTS, with weights from a seed: the real ones are not here, nor are their figures."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import torch

from benchmarks.perceptual.networks import Networks
from tests.metrics.test_metrics import disturbed, picture

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
