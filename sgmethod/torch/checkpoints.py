"""Checkpoints of GaussianImage and Image-GS -> Gaussians.

|                | GaussianImage (Cholesky and RS)             | Image-GS                                          |
|----------------|---------------------------------------------|---------------------------------------------------|
| means          | tanh(_xyz), moved by half a pixel: its      | xy, in parts of the picture                       |
|                | pixels have their centres at whole numbers  |                                                   |
| factors        | _cholesky + 0.5, or _scaling and _rotation  | 1 / scale, in pixels, and rot                     |
| colours        | _features_dc times _opacity                 | feat, of one or three channels                    |
| where one ends | nowhere, about; the nearest Gaussian that   | the same                                          |
|                | ends where those of files do is taken       |                                                   |
| blending       | accumulated, as here                        | normalised over the ten strongest at a pixel:     |
|                |                                             | draw with blend="normalised". A file accumulates, |
|                |                                             | so fit the colours anew before packing            |
| left out       | quantisers and codebooks; values are those  | the optimiser's state, figures                    |
|                | before quantisation                         |                                                   |
"""

from __future__ import annotations

import math
import os
import pickle

import torch
from torch import Tensor

from sgmethod.errors import GaussiansError
from sgmethod.exchange.arrays import own_gaussians
from sgmethod.io.files import checked_path
from sgmethod.scene import FloatArray, Gaussians
from sgmethod.view import NO_CUTOFF, recut

PathLike = str | os.PathLike[str]


def read_gaussianimage(path: PathLike, width: int, height: int) -> Gaussians:
    """Gaussians of a gaussian_model.pth.tar, for a picture of width x height pixels, which the file does not record.

    Raises GaussiansError for anything else, and OSError.
    """
    state = _loaded(path, "_xyz", "_features_dc")
    means = (torch.tanh(state["_xyz"]) + 1) / 2 * torch.tensor([width, height]) + 0.5
    if "_cholesky" in state:
        l1, l2, l3 = (state["_cholesky"] + torch.tensor([0.5, 0, 0.5])).unbind(1)
        factors = torch.stack([l1.abs(), l2 * l1.sign(), l3.abs()], 1)  # the same covariance
    else:
        missing = {"_scaling", "_rotation"} - set(state)
        if missing:
            raise GaussiansError(f"{path} has neither _cholesky nor {min(missing)}")
        factors = _turned((state["_scaling"] + 0.5).abs(), torch.sigmoid(state["_rotation"]) * 2 * math.pi)
    colors = state["_features_dc"] * state.get("_opacity", torch.ones(()))
    return recut(own_gaussians(Gaussians(*map(_array, (means, factors, colors)))), NO_CUTOFF)


def read_image_gs(path: PathLike, width: int, height: int) -> Gaussians:
    """Gaussians of a ckpt_step-N.pt, for a picture of width x height pixels, which the file does not record; to be
    drawn with blend="normalised". Raises GaussiansError for anything else, and OSError."""
    state = _loaded(path, "xy", "scale", "rot", "feat")
    factors = _turned(1 / state["scale"], state["rot"])
    colors = state["feat"]
    if colors.shape[1:] == (1,):
        colors = colors.expand(-1, 3)
    means = state["xy"] * torch.tensor([width, height])
    return recut(own_gaussians(Gaussians(*map(_array, (means, factors, colors)))), NO_CUTOFF)


def _turned(scales: Tensor, angles: Tensor) -> Tensor:
    """Factors [N, 3] of scales [N, 2] along axes that both programs turn by the negative of the angles [N, 1]."""
    cos, sin = angles.cos()[:, 0], angles.sin()[:, 0]
    a, b = scales.T
    l1, xy = ((a * cos) ** 2 + (b * sin) ** 2).sqrt(), (b * b - a * a) * sin * cos
    return torch.stack([l1, xy / l1, (a * b).abs() / l1], 1)


def _loaded(path: PathLike, *needed: str) -> dict[str, Tensor]:
    """The tensors of a checkpoint, in double precision. Nothing of it is run."""
    try:
        found = torch.load(checked_path(path), map_location="cpu", weights_only=True)
    except (RuntimeError, ValueError, KeyError, EOFError, pickle.UnpicklingError) as error:
        raise GaussiansError(f"{path} is no checkpoint that torch loads without running code of it") from error
    state = found.get("state_dict", found) if isinstance(found, dict) else {}
    state = {name: values.detach().double() for name, values in state.items() if isinstance(values, Tensor)}
    if missing := [name for name in needed if name not in state or state[name].ndim != 2]:
        raise GaussiansError(f"{path} has no {missing[0]} [N, ...], which such a checkpoint needs")
    return state


def _array(values: Tensor) -> FloatArray:
    return values.float().numpy()
