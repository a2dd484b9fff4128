"""Gaussians that lie over each other, with opacity and an order, and the files that are made of them.

2DGS: scales and an angle in the picture's plane; a file has its colours and its shapes as entries of two codebooks,
by K-means. 3D-GS: Kerbl et al., "3D Gaussian Splatting for Real-Time Radiance Field Rendering", 2023, seen from one
side, so that its depth is an order and its colour has no direction; scales and quaternion are of three dimensions.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from scipy.cluster.vq import kmeans2
from torch import Tensor

from benchmarks.convergence.network import levels_of
from benchmarks.pictures import Pixels

Array = NDArray[Any]
REACH, RELIST = 3.0, 10  # standard deviations that are drawn; steps after which pixels are listed anew
ENTRIES_BITS, POSITION_BITS, OTHER_BITS = 6, 12, 7
MOST_ALPHA = 0.99
RATES = {"means": 0.3, "scales": 0.02, "turns": 0.02, "depths": 0.02, "opacities": 0.05, "colors": 0.02}
COLUMN = struct.Struct("<IBB")


class Splats:
    """Gaussians as 2DGS has them."""

    scales, turns = 2, 1  # numbers of each

    def __init__(self, pixels: Pixels, count: int) -> None:
        torch.manual_seed(0)
        self.target = torch.tensor(pixels.reshape(-1, 3) / 255, dtype=torch.float32)
        self.size = pixels.shape[1], pixels.shape[0]
        means = places_with_detail(pixels, count)
        wide = np.sqrt(len(self.target) / count) / 2
        x, y = means.astype(int).T
        start = {
            "means": torch.tensor(means),
            "scales": torch.full((count, self.scales), float(np.log(wide))),
            "turns": torch.rand(count, self.turns) * 2 - 1,
            "opacities": torch.zeros(count, 1),
            "depths": torch.rand(count, 1),
            "colors": torch.tensor(pixels[y, x] / 255),
        }
        self.values = {name: value.float().requires_grad_() for name, value in start.items()}
        groups = [{"params": [value], "lr": RATES[name]} for name, value in self.values.items()]
        self._adam, self._steps = torch.optim.Adam(groups, eps=1e-15), 0

    def step(self) -> None:
        """Take one step, by all pixels."""
        if self._steps % RELIST == 0:
            self._listed = self.listed()
        self._steps += 1
        self._adam.zero_grad()
        loss = (self.blended(*self._listed) - self.target).square().mean()
        loss.backward()  # type: ignore[no-untyped-call]
        self._adam.step()

    def covariances(self) -> Tensor:
        """Covariances [N, 2, 2] in the picture's plane."""
        angle = torch.pi * self.values["turns"][:, 0]
        turned = torch.stack([angle.cos(), -angle.sin(), angle.sin(), angle.cos()], 1).view(-1, 2, 2)
        return self._spread(turned * self.values["scales"].exp()[:, None])

    @staticmethod
    def _spread(factors: Tensor) -> Tensor:
        """Covariances in the picture's plane, widened by the extent of a pixel as in 3D-GS."""
        return (factors @ factors.mT)[:, :2, :2] + 0.1 * torch.eye(2)

    @torch.no_grad()
    def listed(self) -> tuple[Tensor, Tensor]:
        """Gaussians and the pixels that they reach, as pairs: by pixel, the nearest first."""
        means, spread = self.values["means"], self.covariances()
        reach = REACH * spread.diagonal(dim1=1, dim2=2).sqrt()
        most = torch.tensor(self.size)
        low = torch.minimum((means - reach).floor().long().clamp(min=0), most)
        sides = (torch.minimum((means + reach).ceil().long(), most) - low).clamp(min=0)
        counts = sides.prod(1)
        owner = torch.repeat_interleave(counts)
        place = torch.arange(len(owner)) - (counts.cumsum(0) - counts)[owner]
        x = low[owner, 0] + place % sides[owner, 0]
        pixel = (low[owner, 1] + place // sides[owner, 0]) * self.size[0] + x
        rank = self.values["depths"][:, 0].argsort().argsort()
        is_near = self._sigma(owner, pixel) < REACH**2 / 2
        owner, pixel = owner[is_near], pixel[is_near]
        order = (pixel * len(means) + rank[owner]).argsort()
        return owner[order], pixel[order]

    def _sigma(self, owner: Tensor, pixel: Tensor) -> Tensor:
        (a, b), (_, c) = (row.unbind(1) for row in self.covariances().unbind(1))
        conics = torch.stack([c, -b, a], 1) / (2 * (a * c - b * b))[:, None]
        dx, dy = (torch.stack([pixel % self.size[0], pixel // self.size[0]]) + 0.5) - self.values["means"][owner].T
        p, q, r = conics[owner].T
        sigma: Tensor = (p * dx + 2 * q * dy) * dx + r * dy * dy
        return sigma

    def blended(self, owner: Tensor, pixel: Tensor) -> Tensor:
        """Colours [pixels, 3], over black. What lies before a Gaussian is a sum of logarithms, in double precision as
        it runs over all pixels."""
        opacity = torch.sigmoid(self.values["opacities"][:, 0])[owner]
        alpha = (opacity * torch.exp(-self._sigma(owner, pixel))).clamp(max=MOST_ALPHA)
        log = torch.log1p(-alpha).double()
        before = log.cumsum(0) - log
        is_first = torch.ones_like(pixel, dtype=torch.bool)
        is_first[1:] = pixel[1:] != pixel[:-1]
        since = before[is_first][is_first.cumsum(0) - 1]
        weights = alpha * (before - since).exp().float()
        return torch.zeros_like(self.target).index_add(0, pixel, weights[:, None] * self.values["colors"][owner])

    @torch.no_grad()
    def picture(self) -> Pixels:
        """The picture that the splats show now."""
        return levels_of(self.blended(*self.listed()).view(self.size[1], self.size[0], 3).numpy())

    def data(self) -> bytes:
        """The splats as a file, without the size of the picture."""
        found = {name: value.detach().numpy() for name, value in self.values.items()}
        order = found["depths"][:, 0].argsort()  # says the depth
        shapes = np.concatenate([found["scales"], found["turns"]], 1)[order]
        books = [kmeans2(values, 1 << ENTRIES_BITS, seed=0, minit="++") for values in (found["colors"][order], shapes)]
        codes = np.stack([code for _, code in books], 1)
        plain = [(found["means"][order], POSITION_BITS), (found["opacities"][order], OTHER_BITS), (codes, ENTRIES_BITS)]
        return packed([*plain, *((book, 2 * OTHER_BITS) for book, _ in books)])

    def take(self, data: bytes) -> None:
        """Take the values of a file."""
        means, opacities, codes, colors, shapes = unpacked(data)
        color, shape = (book[code] for book, code in zip((colors, shapes), codes.round().astype(int).T, strict=True))
        found = {"means": means, "opacities": opacities, "colors": color}
        found |= {"scales": shape[:, : self.scales], "turns": shape[:, self.scales :]}
        self._become(found | {"depths": np.arange(len(means))[:, None]})

    def _become(self, found: dict[str, Array]) -> None:
        self.values = {name: torch.tensor(value, dtype=torch.float32) for name, value in found.items()}


class FlatSplats(Splats):
    """Gaussians as 3D-GS has them; each of their numbers is rounded by itself."""

    scales, turns = 3, 4

    def covariances(self) -> Tensor:
        w, x, y, z = torch.nn.functional.normalize(self.values["turns"], dim=1).unbind(1)
        rows = [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)]
        rows += [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)]
        turned = torch.stack(rows, 1).view(-1, 2, 3)  # the third row is depth
        return self._spread(turned * self.values["scales"].exp()[:, None])

    def data(self) -> bytes:
        found = {name: value.detach().numpy() for name, value in self.values.items()}
        return packed([(found[name], POSITION_BITS if name == "means" else OTHER_BITS) for name in sorted(found)])

    def take(self, data: bytes) -> None:
        self._become(dict(zip(sorted(self.values), unpacked(data), strict=True)))


def bits_of(kind: type[Splats]) -> tuple[int, int]:
    """Bits of each Gaussian, and of the rest of a file at most."""
    if kind is FlatSplats:
        return 2 * POSITION_BITS + OTHER_BITS * (kind.scales + kind.turns + 1 + 1 + 3), 8 * 160
    return 2 * POSITION_BITS + OTHER_BITS + 2 * ENTRIES_BITS, (2 << ENTRIES_BITS) * 3 * 2 * OTHER_BITS + 8 * 160


def packed(columns: Sequence[tuple[Array, int]]) -> bytes:
    """Arrays [N, K], each in so many bits between the least and the most of a column of it."""
    parts = []
    for values, bits in columns:
        low, high = (edge.astype(np.float32) for edge in (values.min(0), values.max(0)))
        steps = np.round((values - low) / np.maximum(high - low, 1e-9) * (2**bits - 1)).astype(np.int64)
        digits = (steps.ravel()[:, None] >> np.arange(bits)) & 1
        parts += [COLUMN.pack(*values.shape, bits), low.tobytes(), high.tobytes()]
        parts.append(np.packbits(digits.astype(np.uint8)).tobytes())
    return b"".join(parts)


def unpacked(data: bytes) -> list[Array]:
    """The arrays that packed() stored."""
    found, at = [], 0
    while at < len(data):
        rows, count, bits = COLUMN.unpack_from(data, at)
        low, high = np.frombuffer(data, np.float32, 2 * count, at + COLUMN.size).reshape(2, count)
        at += COLUMN.size + 8 * count
        length = (rows * count * bits + 7) // 8
        digits = np.unpackbits(np.frombuffer(data, np.uint8, length, at), count=rows * count * bits)
        steps = digits.reshape(-1, bits).astype(np.int64) @ (1 << np.arange(bits))
        found.append(low + steps.reshape(rows, count) / (2**bits - 1) * (high - low))
        at += length
    return found


def places_with_detail(pixels: Pixels, count: int) -> Array:
    """Drawn at random, [count, 2] as x and y, more of them where the picture changes."""
    grey = cv2.GaussianBlur(cv2.cvtColor(pixels, cv2.COLOR_RGB2GRAY).astype(np.float32), (0, 0), 1)
    change = np.hypot(cv2.Sobel(grey, cv2.CV_32F, 1, 0), cv2.Sobel(grey, cv2.CV_32F, 0, 1)).ravel().astype(float)
    change += change.mean() + 1e-3
    rng = np.random.default_rng(0)
    index = rng.choice(change.size, count, p=change / change.sum())
    rows, columns = np.divmod(index, pixels.shape[1])
    return np.stack([columns, rows], 1) + rng.random((count, 2))
