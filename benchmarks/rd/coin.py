"""COIN (Dupont et al., 2021): a network of sines fitted to one picture, whose numbers are the file.

The depth is the authors' for a rate, and the width what the rate allows. Adam has their rate, 2e-4. As with them, the
best network seen is kept, its numbers count with 16 bits each, and width and depth are not counted.

They take 50,000 steps with all pixels, on a GPU. Ten minutes of two cores are about 10,000 steps with 16,384 pixels
each: such rows show what minutes of a CPU give, and not what COIN can reach.
"""

from __future__ import annotations

import time
from dataclasses import replace
from functools import partial

import numpy as np
import torch
from torch.nn.utils import parameters_to_vector, vector_to_parameters

from benchmarks import networks
from benchmarks.convergence.learned import BYTES_OF_NUMBER, trained
from benchmarks.pictures import Pixels
from benchmarks.rd.codecs import Run
from sgmethod.metrics import psnr

RATE = 2e-4
DEEP_FROM = 0.3  # bits per pixel: from here on 9 hidden layers, below 4; the authors count the first layer too


class Coin:
    """Fitted for so many seconds."""

    name = "coin"

    def __init__(self, seconds: float) -> None:
        self.seconds = seconds

    def run(self, pixels: Pixels, aim: float) -> Run:
        """As Codec.run."""
        began = time.perf_counter()
        hidden = 9 if aim >= DEEP_FROM else 4
        size = int(aim * pixels.shape[0] * pixels.shape[1] / 8)
        network = replace(networks.siren(pixels, size // BYTES_OF_NUMBER, hidden), rate=RATE)
        best, data, spent_s = -np.inf, b"", 0.0
        for run_s, (picture, source), _ in trained(network, pixels, self.seconds, began):
            spent_s = run_s
            if (db := psnr(picture, source)) > best:
                numbers = parameters_to_vector(network.numbers).detach().half().numpy()
                best, data = db, numbers.tobytes()
        return Run(data, spent_s, partial(decoded, hidden=hidden, shape=pixels.shape))


def decoded(data: bytes, hidden: int, shape: tuple[int, ...]) -> Pixels:
    """The picture [H, W, 3] of numbers in half precision."""
    numbers = torch.from_numpy(np.frombuffer(data, np.float16).astype(np.float32))
    network = networks.siren(None, len(numbers), hidden)
    vector_to_parameters(numbers, network.numbers)
    return networks.drawn(network, shape)
