"""Files as tensors and Gaussians."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from torch.utils.data import DataLoader

import sgmethod
from sgmethod.errors import SgError, ViewError
from sgmethod.torch import SgDataset, decode, draw, render
from sgmethod.view import View

pytestmark = pytest.mark.usefixtures("files")
SIZE = (64, 48)


def test_decoding_into_a_tensor() -> None:
    pixels, view = sgmethod.decode("picture.sg"), View(0.5)
    assert torch.equal(decode("picture.sg", layout="HWC"), torch.from_numpy(pixels))
    assert torch.equal(decode("picture.sg", "cpu"), torch.from_numpy(pixels).permute(2, 0, 1))
    levels = decode("picture.sg", dtype=torch.float32)
    assert np.array_equal((255 * levels).round().permute(1, 2, 0).numpy(), pixels)
    assert levels.is_contiguous()
    small = torch.from_numpy(sgmethod.decode("picture.sg", view=view))
    assert torch.equal(decode("picture.sg", view=view, layout="HWC"), small)


@pytest.mark.parametrize("is_open", [False, True])
def test_drawing_on_a_device(is_open: bool) -> None:
    drawn = draw(sgmethod.open("picture.sg") if is_open else "picture.sg", "cpu")
    assert drawn.dtype == torch.uint8
    assert (drawn.int() - decode("picture.sg").int()).abs().max() <= 1


def test_a_data_set_of_pixels() -> None:
    for size in ((30, 20), (20, 30), (100, 50), (48, 40)):
        width, height = size
        (batch,) = DataLoader(SgDataset(["picture.sg"] * 2, size=size), batch_size=2)
        assert batch["pixels"].shape == (2, 3, height, width)
    whole = sgmethod.decode("picture.sg").mean((0, 1))
    assert np.abs(batch["pixels"][0].float().mean((1, 2)).numpy() - whole).max() < 3


def test_a_data_set_of_gaussians() -> None:
    file = sgmethod.open("picture.sg")
    n = file.info.gaussians
    (batch,) = DataLoader(SgDataset(["picture.sg"] * 2, max_gaussians=n + 9), batch_size=2)
    assert batch["mask"].sum(1).tolist() == [n, n]
    images = render(batch["means"], batch["factors"], batch["colors"], file.size, batch["background"], pyramid=True)
    assert np.abs(255 * images[1].clamp(0, 1).permute(1, 2, 0).numpy() - file.pixels()).max() < 0.51
    few = SgDataset([file_bytes := Path("picture.sg").read_bytes()], max_gaussians=5)[0]
    assert few["mask"].all()
    assert np.array_equal(few["means"].numpy(), sgmethod.open(file_bytes).gaussians().means[:5])


@pytest.mark.parametrize(
    ("call", "error", "words"),
    [
        (lambda: decode("picture.sg", dtype=torch.int32), SgError, "uint8 or of a floating-point type"),
        (lambda: decode("picture.sg", "cuda:99"), SgError, "there is no device 'cuda:99' here"),
        (lambda: decode("picture.sg", layout="NCHW"), SgError, "CHW or HWC, not 'NCHW'"),
        (lambda: SgDataset(["picture.sg"]), SgError, "needs either size or max_gaussians"),
        (lambda: SgDataset("picture.sg", size=(8, 8)), SgError, "a list of files, not one file"),
        (lambda: SgDataset(["picture.sg"], size=(8, -8)), ViewError, "a side must be a whole number from 1"),
        (lambda: SgDataset(["picture.sg"], size=8), ViewError, "a size is width and height in pixels, not 8"),
        (lambda: SgDataset(["picture.sg"], max_gaussians=-1), SgError, "max_gaussians must be a whole number from 1"),
        (lambda: SgDataset(["picture.sg"], size=(1, 9000))[0], ViewError, "a picture of 48 x 40 cannot cover"),
    ],
)
def test_wrong_arguments(call: Callable[[], object], error: type[SgError], words: str) -> None:
    with pytest.raises(error, match=words):
        call()
