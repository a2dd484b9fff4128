"""The backend of operations on tensors, against the reference and in whole fits; names of devices."""

from __future__ import annotations

import numpy as np
import pytest
import torch

import sgmethod
from sgmethod.backend.kernels import Kernels
from sgmethod.backend.protocol import Backend, Frame
from sgmethod.fitting.deadline import Clock
from sgmethod.torch.devices import checked_device
from sgmethod.torch.exact import ExactFit
from sgmethod.torch.tensors import Tensors
from tests.backend.cases import FRAMES, over, target, worst
from tests.definitions.backend import Reference
from tests.support.pictures import photo

CPU, REFERENCE = torch.device("cpu"), Reference()


def assert_as_reference(backend: Backend, frame: Frame) -> None:
    """Residual, error, gradients and Gram product. Of arrays, errors are in parts of the largest value."""
    gaussians, wanted = over(frame, 1), target(1)
    for first, end, half in ((0, frame.height, False), (0, frame.height, True), (13, 30, False)):
        rows = [
            each.residual(gaussians, frame, wanted[:, first:end], first, half=half) for each in (backend, REFERENCE)
        ]
        assert worst(*rows) < 1e-5  # worst seen 2.9e-6
    error, gradient = backend.gradients(gaussians, frame, wanted)
    exact_error, exact = REFERENCE.gradients(gaussians, frame, wanted)
    assert error == pytest.approx(exact_error, rel=3e-6)  # worst seen 1.1e-6
    assert backend.error(gaussians, frame, wanted) == pytest.approx(exact_error, rel=3e-6)
    assert all(worst(*pair) < 1e-5 for pair in zip(gradient.arrays, exact.arrays, strict=True))  # worst seen 4.4e-6
    assert worst(backend.gram(gaussians, frame), REFERENCE.gram(gaussians, frame)) < 1e-5  # worst seen 3.4e-6


@pytest.mark.parametrize("name", FRAMES)
def test_backend(name: str) -> None:
    assert_as_reference(Tensors(CPU), FRAMES[name])


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
