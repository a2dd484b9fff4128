"""Fits of batches of pictures: exactly N Gaussians for each, as tensors, without a file."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_EXCEPTION, Future, ThreadPoolExecutor, wait
from contextlib import AbstractContextManager, nullcontext
from functools import partial
from threading import Event
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from sgmethod.arguments import AnyFloat, AnyInt, checked_integer, finite_number
from sgmethod.backend.kernels import Kernels
from sgmethod.backend.protocol import Backend
from sgmethod.bitstream.v2 import MAX_QUANTUM, MIN_QUANTUM
from sgmethod.budget import MAX_GAUSSIANS
from sgmethod.errors import BudgetError, ImageError, SgError
from sgmethod.fitting.deadline import Clock
from sgmethod.io.decoding import check_range
from sgmethod.io.image import ImageLimits
from sgmethod.native import native
from sgmethod.scene import Pixels
from sgmethod.torch.devices import checked_device, has_tiles
from sgmethod.torch.exact import Exact, ExactFit
from sgmethod.torch.tensors import Tensors

OnProgress = Callable[[float], None]
MAX_STEPS = 1_000_000
POLLED_S = 0.05  # between two calls of the caller's functions
# Pictures of a batch on a GPU: each has a thread, and some ten planes as large as itself in 32 bits.
MAX_TOGETHER, SAMPLES_TOGETHER = 256, 1 << 26


class Fit(NamedTuple):
    """N Gaussians for each of B pictures, for render() and pack().

    error: mean squared error, 1 being white, as render(pyramid=True) draws.
    """

    means: Tensor  # [B, N, 2]
    factors: Tensor  # [B, N, 3]
    colors: Tensor  # [B, N, 3]
    background: Tensor  # [B, 3]
    error: Tensor  # [B]


def fit(
    images: Tensor,
    gaussians: AnyInt,
    *,
    steps: AnyInt | None = None,
    quantum: AnyFloat | None = None,
    on_progress: OnProgress | None = None,
) -> Fit:
    """Fit exactly N Gaussians to each picture of a batch.

    >>> found = fit(torch.rand(2, 3, 24, 32), 20, steps=10)
    >>> found.means.shape, found.background.shape
    (torch.Size([2, 20, 2]), torch.Size([2, 3]))
    >>> image = sgmethod.torch.render(*found[:3], (32, 24), found.background, pyramid=True)

    images: [B, 3, H, W], sRGB, uint8 or floating point in [0, 1], which is rounded to 8 bits. The result is on their
    device, which also does the work.
    gaussians: number for each picture, at most its number of pixels. The largest come first.
    steps: the default, 150 to 340 depending on the Gaussians per pixel, has about the PSNR of encode(gaussians=N).
    quantum: also minimise the bits that pack() will need with this quantum. By default, bits are free.
    on_progress: called with the share that is done, 0 to 1; if it raises, the fits are abandoned.

    If a batch has at least as many pictures as there are cores, each core fits one picture at a time. In a smaller
    batch, all cores fit one picture after the other. On a GPU with Triton, pictures take their steps in one batch. A
    picture's result depends neither on the others nor on the number of threads.

    Raises ImageError for anything but a batch of pictures, and BudgetError.
    """
    pictures, device = pictures_of(images), images.device
    task = task_of(gaussians, images.shape[2:].numel(), steps, quantum)
    found = fit_pictures(pictures, task, device, on_progress)
    arrays = zip(*(one.gaussians.arrays for one in found), strict=True) if found else ((), (), ())
    means, factors, colors = (
        torch.from_numpy(np.array(values, np.float32).reshape(len(found), task.gaussians, width)).to(device)
        for values, width in zip(arrays, (2, 3, 3), strict=True)
    )
    levels = torch.tensor([one.background for one in found], dtype=torch.float32, device=device)
    error = torch.tensor([one.error for one in found], dtype=torch.float32, device=device)
    return Fit(means, factors, colors, levels.reshape(-1, 3) / 255, error)


def task_of(gaussians: AnyInt, pixels: int, steps: AnyInt | None, quantum: AnyFloat | None) -> ExactFit:
    """Check the arguments of a fit of pictures that have at least this many pixels. Raises BudgetError."""
    gaussians = checked_integer(gaussians, "gaussians", 1, min(pixels, MAX_GAUSSIANS), BudgetError)
    steps = None if steps is None else checked_integer(steps, "steps", 1, MAX_STEPS, BudgetError)
    price = 0.0 if quantum is None else finite_number(quantum)
    if price is None or (quantum is not None and not MIN_QUANTUM <= price <= MAX_QUANTUM):
        raise BudgetError(f"the quantum must be from {MIN_QUANTUM} to {MAX_QUANTUM:g}, got {quantum!r}")
    return ExactFit(gaussians, steps, price)


def fit_pictures(
    pictures: Sequence[Pixels],
    task: ExactFit,
    device: torch.device,
    on_progress: OnProgress | None = None,
) -> list[Exact]:
    """Fit pictures of any sizes: on the CPU one a core if there are enough, on a GPU many in one batch.

    The work is done in threads, and on_progress is called in this one.
    """
    watch = _Watch(len(pictures), on_progress)
    places, backends = _backends(pictures, device, watch.abandoned)
    clock = Clock()

    def fitted(index: int) -> Exact:
        with backends[index] as backend:
            return task.fit(pictures[index], backend, clock, partial(watch.note, index))

    with ThreadPoolExecutor(places, "fit", native.stay_alone if places > 1 else None) as pool:
        futures = [pool.submit(fitted, index) for index in range(len(pictures))]
        try:
            return watch.results(futures)
        except BaseException:
            watch.abandoned.set()
            pool.shutdown(cancel_futures=True)
            raise


def _backends(
    pictures: Sequence[Pixels], device: torch.device, abandoned: Event
) -> tuple[int, list[AbstractContextManager[Backend]]]:
    """How many pictures are fitted at a time, and the backend of each, to be left when its fit ends."""
    if has_tiles(device):
        from sgmethod.torch.batched import BatchedTensors

        places = max(1, min(MAX_TOGETHER, SAMPLES_TOGETHER // max(map(np.size, pictures), default=1)))
        starts = range(0, len(pictures), places)
        batches = [BatchedTensors(device, len(pictures[start : start + places]), abandoned) for start in starts]
        return places, [batches[index // places] for index in range(len(pictures))]
    if device.type == "cpu":
        places = native.thread_count() if len(pictures) >= native.thread_count() else 1
        return places, [nullcontext(Kernels())] * len(pictures)
    return 1, [nullcontext(Tensors(device))] * len(pictures)


class _Watch:
    """Fits in other threads, as their caller sees them. abandoned: they must end."""

    def __init__(self, fits: int, on_progress: OnProgress | None) -> None:
        self._shares, self._on_progress = [0.0] * fits, on_progress
        self.abandoned = Event()

    def note(self, index: int, share: float) -> None:
        """Note a fit's progress, in its thread. Raises SgError if the fits were abandoned."""
        self._shares[index] = share
        if self.abandoned.is_set():
            raise SgError("the fits were abandoned")

    def results(self, futures: Sequence[Future[Exact]]) -> list[Exact]:
        """Wait for all, and meanwhile call on_progress. Raises the first error."""
        while wait(futures, POLLED_S, FIRST_EXCEPTION).not_done:
            for future in futures:
                if future.done():
                    future.result()  # raises its error
            if self._on_progress is not None:
                self._on_progress(math.fsum(self._shares) / len(self._shares))
        found = [future.result() for future in futures]
        if self._on_progress is not None:
            self._on_progress(1.0)
        return found


def pictures_of(images: Tensor) -> list[Pixels]:
    """Return the pictures of a batch, each [H, W, 3]. Raises ImageError, and SgError for a device without values."""
    if not isinstance(images, Tensor) or images.ndim != 4 or images.shape[1] != 3:
        found = list(images.shape) if isinstance(images, Tensor) else type(images).__name__
        raise ImageError(f"images must be a tensor [B, 3, H, W] in red, green and blue, not {found}")
    checked_device(images.device)
    ImageLimits().check(images.shape[3], images.shape[2])
    if images.dtype != torch.uint8:
        if not images.is_floating_point():
            raise ImageError(f"images must be uint8 or floating-point values in [0, 1], not {images.dtype}")
        low, high = (float(value) for value in images.detach().aminmax()) if images.numel() else (0.0, 1.0)
        check_range(low, high)
        images = (255 * images.detach().float()).round().to(torch.uint8)
    return list(images.permute(0, 2, 3, 1).contiguous().cpu().numpy())
