"""Files and checkpoints as tensors and Gaussians."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from torch.utils.data import DataLoader

import sgmethod
from sgmethod.errors import GaussiansError, SgError, ViewError
from sgmethod.torch import SgDataset, decode, read_gaussianimage, read_image_gs, render
from sgmethod.view import WHOLE, View, recut
from tests.backend.cases import single

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


def test_a_data_set_of_pixels() -> None:
    """Of any size and shape; the middle of the picture is in the middle."""
    for size in ((30, 20), (20, 30), (100, 50), (48, 40)):
        width, height = size
        (batch,) = DataLoader(SgDataset(["picture.sg"] * 2, size=size), batch_size=2)
        assert batch["pixels"].shape == (2, 3, height, width)
    whole = sgmethod.decode("picture.sg").mean((0, 1))
    assert np.abs(batch["pixels"][0].float().mean((1, 2)).numpy() - whole).max() < 3


def test_a_data_set_of_gaussians() -> None:
    """Padded, they draw the file."""
    file = sgmethod.open("picture.sg")
    n = file.info.gaussians
    (batch,) = DataLoader(SgDataset(["picture.sg"] * 2, most_gaussians=n + 9), batch_size=2)
    assert batch["mask"].sum(1).tolist() == [n, n]
    images = render(batch["means"], batch["factors"], batch["colors"], file.size, batch["background"])
    assert np.abs(255 * images[1].clamp(0, 1).permute(1, 2, 0).numpy() - file.pixels()).max() < 0.51
    few = SgDataset([file_bytes := Path("picture.sg").read_bytes()], most_gaussians=5)[0]
    assert few["mask"].all()
    assert np.array_equal(few["means"].numpy(), sgmethod.open(file_bytes).gaussians().means[:5])


@pytest.mark.parametrize(
    ("call", "error", "words"),
    [
        (lambda: decode("picture.sg", dtype=torch.int32), SgError, "uint8 or of a floating-point type"),
        (lambda: decode("picture.sg", "cuda:99"), SgError, "there is no device 'cuda:99' here"),
        (lambda: decode("picture.sg", layout="NCHW"), SgError, "CHW or HWC, not 'NCHW'"),
        (lambda: SgDataset(["picture.sg"]), SgError, "needs either size or most_gaussians"),
        (lambda: SgDataset("picture.sg", size=(8, 8)), SgError, "a list of files, not one file"),
        (lambda: SgDataset(["picture.sg"], size=(8, -8)), ViewError, "a side must be a whole number from 1"),
        (lambda: SgDataset(["picture.sg"], size=8), ViewError, "a size is width and height in pixels, not 8"),
        (lambda: SgDataset(["picture.sg"], most_gaussians=-1), SgError, "most_gaussians must be a whole number from 1"),
        (lambda: SgDataset(["picture.sg"], size=(1, 9000))[0], ViewError, "no size for a picture of 48 x 40"),
    ],
)
def test_what_is_wrong_is_said(call: Callable[[], object], error: type[SgError], words: str) -> None:
    with pytest.raises(error, match=words):
        call()


# --- checkpoints, as the programs write them: GaussianImage its state_dict, Image-GS one in a dictionary


def cholesky() -> dict[str, torch.Tensor]:
    places = {"_xyz": torch.atanh(torch.tensor([[-0.5, 0.25]])), "_cholesky": torch.tensor([[-2.5, 1.0, 2.5]])}
    colors = {"_features_dc": torch.tensor([[0.5, -0.25, 1]]), "background": torch.ones(3)}
    return places | colors | {"_opacity": torch.ones(1, 1)}


def test_gaussianimage() -> None:
    torch.save(cholesky(), "model.pth.tar")
    wanted = single([[16.5, 30.5]], [[2, -1, 3]], [[0.5, -0.25, 1]])
    found = read_gaussianimage("model.pth.tar", *SIZE)
    for one, other in zip(found.arrays, recut(wanted, WHOLE).arrays, strict=True):
        assert np.allclose(one, other, rtol=1e-6)


def test_gaussianimage_by_scale_and_rotation() -> None:
    """Its matrix of rotation has the sine's signs exchanged, so an angle turns from x to -y."""
    angle = math.pi / 6
    turned = torch.logit(torch.tensor([[angle / (2 * math.pi)]], dtype=torch.float64))
    state = cholesky() | {"_scaling": torch.tensor([[-4.5, 0.5]]), "_rotation": turned}
    del state["_cholesky"]
    torch.save(state, "model.pth.tar")
    found = read_gaussianimage("model.pth.tar", *SIZE)
    axis = np.array([math.cos(angle), -math.sin(angle)])
    variances = recut(found, 3.0, WHOLE).covariances[0]
    assert axis @ variances @ axis == pytest.approx(16, rel=1e-5)
    assert np.linalg.det(variances) == pytest.approx(16, rel=1e-5)


@pytest.mark.parametrize("channels", [1, 3])
def test_image_gs(channels: int) -> None:
    state = {"xy": torch.tensor([[0.25, 0.5]]), "scale": torch.tensor([[0.5, 0.25]]), "rot": torch.zeros(1, 1)}
    state |= {"feat": torch.tensor([[0.5, 0.25, 1]])[:, :channels], "vis_feat": torch.zeros(1, 3)}
    torch.save({"step": 3, "psnr": 30.0, "state_dict": state, "optim_state_dict": {"state": {}}}, "ckpt_step-3.pt")
    wanted = single([[16, 24]], [[2, 0, 4]], [[0.5, 0.25, 1]] if channels == 3 else [[0.5] * 3])
    for one, other in zip(read_image_gs("ckpt_step-3.pt", *SIZE).arrays, recut(wanted, WHOLE).arrays, strict=True):
        assert np.allclose(one, other, rtol=1e-6, atol=1e-6)


def test_what_is_no_checkpoint() -> None:
    """Code that a checkpoint holds is not run."""
    Path("text.pt").write_text("no checkpoint")
    torch.save(cholesky() | {"_xyz": torch.ones(3)}, "flat.pt")
    torch.save({name: values for name, values in cholesky().items() if name != "_cholesky"}, "part.pt")
    torch.save({"state_dict": print}, "code.pt")
    refused = {"text.pt": "no checkpoint", "code.pt": "no checkpoint", "flat.pt": "no _xyz", "part.pt": "_rot"}
    for name, words in refused.items():
        with pytest.raises(GaussiansError, match=words):
            read_gaussianimage(name, *SIZE)
    with pytest.raises(GaussiansError, match="has no xy"):
        read_image_gs("flat.pt", *SIZE)
