"""Other ways to fit the same picture: plain Adam on the raw numbers of Gaussians, and a network of the file's bytes.

Each yields its picture at growing times. Until the end, a network shows the pixels of every few rows and columns of a
large picture, since it takes a minute to draw all of 12 megapixels. The clock stands while a picture is drawn and
measured.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator

import numpy as np
import torch

from benchmarks.convergence import network as networks
from benchmarks.convergence.network import Training, drawn, levels_of
from benchmarks.pictures import Pixels
from sgmethod.backend.kernels import Kernels
from sgmethod.backend.protocol import Frame
from sgmethod.fitting.level import Level, target_of
from sgmethod.native import native
from sgmethod.settings.paper import BASELINE
from sgmethod.start.placement import place

Look = tuple[Pixels, Pixels]  # of what is shown and of the picture the same pixels, [H, W, 3]
Shown = Iterator[tuple[float, Look]]  # with the seconds so far
FIRST_S, GROWTH = 0.1, 1.25  # when the picture is looked at
REST = 0.2  # of what a look took, before the next: to draw a picture can take longer than steps
LOOKED_AT = 2.5e5  # pixels, about, of a network's picture
# The best of 0.02, 0.05, 0.1, 0.2, by the PSNR of 600 Gaussians after 400 steps on astronaut at 128x128.
RATE_OF_ADAM = 0.2
BYTES_OF_NUMBER = 2  # half precision, as COIN stores them


def plain_adam(pixels: Pixels, seconds: float, gaussians: int) -> Shown:
    """Gaussians from a random start, all their raw numbers moved by torch's Adam; what is shown is no file."""
    began = time.perf_counter()
    torch.set_num_threads(1)  # or its threads and the kernels' would wait for each other
    found = place(pixels.astype(np.float32) / np.float32(255), gaussians, BASELINE.start, np.random.default_rng(0))
    level = Level(Kernels(), Frame(pixels.shape[1], pixels.shape[0], pyramid=False), target_of(pixels))
    tensors = [torch.from_numpy(values) for values in found.arrays]  # over the same memory
    optimiser = torch.optim.Adam(tensors, lr=RATE_OF_ADAM)

    def step() -> None:
        _, gradient = level.gradients(found)
        for tensor, values in zip(tensors, gradient.arrays, strict=True):
            tensor.grad = torch.from_numpy(values)
        optimiser.step()
        np.maximum(found.factors[:, 0::2], BASELINE.optimiser.min_scale_px, out=found.factors[:, 0::2])
        np.clip(found.colors, -2, 2, out=found.colors)

    def show(_: bool) -> Look:
        missing = level.residual(found)(0, pixels.shape[0]).transpose(1, 2, 0)
        return levels_of(pixels / np.float32(255) - missing), pixels

    yield from watched(step, show, seconds, began)


def siren(pixels: Pixels, seconds: float, size: int) -> Shown:
    """A network as wide as the bytes allow. What is shown has its numbers rounded to half precision."""
    began = time.perf_counter()
    network = networks.siren(size // BYTES_OF_NUMBER)
    torch.set_num_threads(native.thread_count())
    training = Training(network, pixels)

    @torch.no_grad()
    def show(whole: bool) -> Look:
        apart = 1 if whole else max(1, round(math.sqrt(pixels[..., 0].size / LOOKED_AT)))
        kept = [number.clone() for number in network.numbers]
        for number in network.numbers:
            number.copy_(number.half().float())
        shown = drawn(network, pixels.shape, apart)
        for number, value in zip(network.numbers, kept, strict=True):
            number.copy_(value)
        return shown, pixels[::apart, ::apart]

    yield from watched(training.step, show, seconds, began)


def watched(step: Callable[[], None], show: Callable[[bool], Look], seconds: float, began: float) -> Shown:
    """Repeat a step for a number of seconds, and show what has become at times that grow by a factor, or further
    apart where a look takes long. show: is told whether it is the last time."""
    due, stood = FIRST_S, 0.0
    while True:
        step()
        run = time.perf_counter() - began - stood
        if run >= min(due, seconds):
            paused = time.perf_counter()
            yield run, show(run >= seconds)
            if run >= seconds:
                return
            looked = time.perf_counter() - paused
            stood += looked
            due = run + max(run * (GROWTH - 1), looked * REST)
