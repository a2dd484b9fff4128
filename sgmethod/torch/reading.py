""".sg files as tensors: pictures, Gaussians, and data sets of either."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from typing import Any, Literal

import numpy as np
import torch
from torch import Tensor
from torch.utils.data import Dataset

from sgmethod import decoder
from sgmethod.arguments import AnyInt, checked_integer
from sgmethod.budget import MAX_GAUSSIANS
from sgmethod.decoder import MAX_PIXELS, WHOLE, SgFile
from sgmethod.errors import SgError, ViewError
from sgmethod.io.files import File
from sgmethod.scene import Gaussians
from sgmethod.torch.devices import checked_device
from sgmethod.torch.drawing import checked_size, render
from sgmethod.torch.shards import Sample, samples_of
from sgmethod.view import MAX_SCALE, MIN_SCALE, View

Device = str | torch.device | None
Layout = Literal["CHW", "HWC"]


def decode(
    file: File,
    device: Device = None,
    *,
    dtype: torch.dtype = torch.uint8,
    layout: Layout = "CHW",
    view: View = WHOLE,
    max_pixels: AnyInt = MAX_PIXELS,
) -> Tensor:
    """Decode an .sg file, or a view of it, to a tensor on a device: [3, H, W], [4, H, W] with alpha.

    >>> decode("photo.sg", dtype=torch.float32).shape
    torch.Size([3, 96, 128])

    dtype: uint8 for levels, a floating-point type for values in [0, 1]; layout: "HWC" for [H, W, 3 or 4]. The other
    arguments and errors are the same as for sgmethod.decode(), which draws the pixels on the CPU, so they are equal on
    every device. Raises SgError for a device that is missing.
    """
    found = checked_device(device)
    return _tensor(decoder.decode(file, max_pixels, view), dtype, layout).to(found)


def gaussians(
    file: File | SgFile | Gaussians, device: Device = None, dtype: torch.dtype = torch.float32
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Return means [N, 2], factors [N, 3], colours [N, 3] and background [3] for render().

    >>> means, factors, colors, background = gaussians("photo.sg")

    Raises BitstreamError, OSError, and SgError for a device that is not there.
    """
    if isinstance(file, Gaussians):
        found, background = file, (0.0, 0.0, 0.0)
    else:
        opened = file if isinstance(file, SgFile) else SgFile(file)
        found, background = opened.gaussians(), opened.background
    where = checked_device(device)
    means, factors, colors = (torch.as_tensor(values, dtype=dtype, device=where) for values in found.arrays)
    return means, factors, colors, torch.tensor(background, dtype=dtype, device=where)


def draw(file: File | SgFile, device: Device = None) -> Tensor:
    """Draw the Gaussians of an .sg file on a device, where decode() draws on the CPU: uint8 [3, H, W].

    >>> draw("photo.sg").shape
    torch.Size([3, 96, 128])

    Only the bits are read on the CPU. Texture and alpha are left out; some pixels differ from decode() by one level.
    Raises BitstreamError, OSError, and SgError for a device that is missing.
    """
    opened = file if isinstance(file, SgFile) else SgFile(file)
    means, factors, colors, background = gaussians(opened, device)
    picture = render(means, factors, colors, opened.size, background, pyramid=True)
    return (255 * picture.clamp(0, 1) + 0.5).to(torch.uint8)


class SgDataset(Dataset[dict[str, Any]]):
    """A map-style data set of .sg files or of fitted pictures. Its items stack to batches.

    >>> SgDataset(["photo.sg"], size=(32, 32))[0]["pixels"].shape
    torch.Size([3, 32, 32])
    >>> SgDataset(["photo.sg"], max_gaussians=500)[0]["mask"].shape
    torch.Size([500])

    files: .sg files, in the order in which they are given; or a folder of fit_many(), or one of its shards.
    size: each item has "pixels" [3, height, width], uint8, without alpha: the middle of the picture, scaled
    to cover that width and height. Only for .sg files.
    max_gaussians: each item has "means", "factors", "colors" [M, ...] and "mask" [M], True for a Gaussian; "size"
    (width, height) and "background" [3]; and "cls" or "json", if it was fitted with a label. The first Gaussians, which
    are the largest, are taken, and zeros, which draw nothing, fill the rest.
    Raises SgError unless exactly one of size and max_gaussians is given, for a single .sg file instead of a list, and
    for a folder without shards; OSError for a file that cannot be read.
    """

    def __init__(
        self,
        files: Sequence[File] | str | os.PathLike[str],
        *,
        size: Iterable[AnyInt] | None = None,
        max_gaussians: AnyInt | None = None,
    ) -> None:
        if (size is None) == (max_gaussians is None):
            raise SgError("SgDataset needs either size or max_gaussians")
        if isinstance(files, bytes) or (isinstance(files, str | os.PathLike) and size is not None):
            raise SgError("SgDataset needs a list of files, not one file; what is fitted has Gaussians, and no pixels")
        self._files: Sequence[File | Sample] = samples_of(files) if isinstance(files, str | os.PathLike) else files
        self._size = None if size is None else checked_size(size)
        self._limit = 0 if max_gaussians is None else checked_integer(max_gaussians, "max_gaussians", 1, MAX_GAUSSIANS)

    def __len__(self) -> int:
        return len(self._files)

    def __getitem__(self, index: int) -> dict[str, Any]:
        file = self._files[index]
        if isinstance(file, Sample):
            arrays = {name: torch.from_numpy(values) for name, values in file.arrays().items()}
            return {**_padded(arrays, self._limit), **file.label()}
        opened = SgFile(file)
        if self._size is not None:
            return {"pixels": _covering(opened, self._size)}
        values = zip(("means", "factors", "colors", "background"), gaussians(opened), strict=True)
        return _padded({**dict(values), "size": torch.tensor(opened.size)}, self._limit)


def _padded(found: dict[str, Tensor], limit: int) -> dict[str, Tensor]:
    """Return the first Gaussians of a picture, padded with zeros."""
    mask = torch.arange(limit) < len(found["means"])
    padded = {name: found[name][:limit] for name in ("means", "factors", "colors")}
    padded = {
        name: torch.cat([some, some.new_zeros(limit - len(some), some.shape[1])]) for name, some in padded.items()
    }
    return {**found, **padded, "mask": mask}


def _covering(file: SgFile, size: tuple[int, int]) -> Tensor:
    """Draw a picture just large enough, and crop its middle to [3, height, width]."""
    width, height = size
    scale = max((side + 0.5) / whole for side, whole in zip(size, file.size, strict=True))
    if not MIN_SCALE <= scale <= MAX_SCALE:
        raise ViewError(f"a picture of {file.size[0]} x {file.size[1]} cannot cover {width} x {height} pixels")
    pixels = file.pixels(scale)
    y, x = (pixels.shape[0] - height) // 2, (pixels.shape[1] - width) // 2
    return _tensor(pixels[y : y + height, x : x + width, :3], torch.uint8, "CHW")


def _tensor(pixels: np.ndarray, dtype: torch.dtype, layout: Layout) -> Tensor:
    if not isinstance(dtype, torch.dtype) or not (dtype == torch.uint8 or dtype.is_floating_point):
        raise SgError(f"pixels are uint8 or of a floating-point type, not {dtype}")
    if layout not in ("CHW", "HWC"):
        raise SgError(f"the layout of pixels is CHW or HWC, not {layout!r}")
    tensor = torch.from_numpy(pixels)
    tensor = tensor.permute(2, 0, 1).contiguous() if layout == "CHW" else tensor
    return tensor if dtype == torch.uint8 else tensor.to(dtype) / 255
