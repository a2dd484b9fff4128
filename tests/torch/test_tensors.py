"""Whole fits by operations on tensors, and names of devices; tests/backend has what such a backend computes."""

from __future__ import annotations

import numpy as np
import pytest
import torch

import sgmethod
from sgmethod.backend.kernels import Kernels
from sgmethod.fitting.deadline import Clock
from sgmethod.torch.devices import checked_device
from sgmethod.torch.exact import ExactFit
from sgmethod.torch.tensors import Tensors
from tests.support.pictures import photo

CPU = torch.device("cpu")


def test_fits_are_as_good_as_those_of_the_kernels() -> None:
    """On average: fits with other last bits end apart."""
    gains = []
    for x, y in ((0, 0), (40, 32), (80, 64)):
        pixels = np.ascontiguousarray(photo()[y : y + 32, x : x + 40])
        of_kernels, of_tensors = (
            ExactFit(30, steps=40).fit(pixels, backend, Clock(), lambda _: None).error
            for backend in (Kernels(), Tensors(CPU))
        )
        gains.append(10 * np.log10(of_kernels / of_tensors))
    assert np.mean(gains) > -0.2  # dB


@pytest.mark.parametrize("name", ["gpu", "cuda:99", "mps" if torch.cuda.is_available() else "cuda", "meta", "", 7])
def test_no_device(name: object) -> None:
    assert checked_device(None) == CPU
    with pytest.raises(sgmethod.SgError, match=r"^there is no device '.*' here: [^\n]+$"):
        checked_device(name)
