"""Each backend against the reference: what is drawn, its errors and gradients.

Errors of an array are in parts of its largest value, which single precision makes 1e-7 at least.
"""

from __future__ import annotations

import os
from itertools import product
from threading import Event

import numpy as np
import pytest
import torch

from sgmethod.backend.kernels import Kernels
from sgmethod.backend.protocol import TARGET_WHITE, Backend, Frame
from sgmethod.scene import Gaussians
from sgmethod.torch.tensors import Tensors
from tests.backend.cases import FRAMES, VISIBILITIES, image, over, target, visibility, worst
from tests.definitions.backend import Reference

KERNELS, REFERENCE = Kernels(), Reference()
CPU = torch.device("cpu")
BACKENDS: dict[str, Backend] = {"kernels": KERNELS, "tensors": Tensors(CPU)}
if os.environ.get("TRITON_INTERPRET"):  # tests/torch/test_tiles.py
    from sgmethod.torch.batched import BatchedTensors

    BACKENDS["tiles"] = BatchedTensors(CPU, 1, Event())

each_backend = pytest.mark.parametrize("backend", BACKENDS.values(), ids=BACKENDS)
every_frame = pytest.mark.parametrize("frame", FRAMES.values(), ids=FRAMES)
# Where tensors are, all pixels count alike.
each_visibility = pytest.mark.parametrize(
    ("backend", "kind"),
    [
        *(pytest.param(KERNELS, kind, id=f"kernels, {kind}") for kind in VISIBILITIES),
        *(pytest.param(backend, "none", id=name) for name, backend in BACKENDS.items() if backend is not KERNELS),
    ],
)


@each_backend
@every_frame
def test_residual(frame: Frame, backend: Backend) -> None:
    gaussians, wanted = over(frame, 1), target(1)
    for first, end, half in (*product((0,), (frame.height, 9), (False, True)), (13, 30, False)):
        asked = gaussians, frame, wanted[:, first:end], first
        found = [each.residual(*asked, half=half) for each in (backend, REFERENCE)]
        assert worst(*found) < 1e-5  # worst seen 2.9e-6


@each_visibility
@every_frame
def test_error_and_gradients(frame: Frame, backend: Backend, kind: str) -> None:
    asked = over(frame, 1), frame, target(1), visibility(kind, 1)
    error, gradient = backend.gradients(*asked)
    wanted_error, wanted = REFERENCE.gradients(*asked)
    assert REFERENCE.error(*asked) == pytest.approx(wanted_error, rel=1e-14)
    assert error == pytest.approx(wanted_error, rel=3e-6)  # worst seen 1.1e-6
    assert backend.error(*asked) == pytest.approx(wanted_error, rel=3e-6)  # worst seen 1.1e-6
    for by, wanted_by in zip(gradient.arrays, wanted.arrays, strict=True):
        assert worst(by, wanted_by) < 1e-5  # worst seen 4.4e-6


@pytest.mark.parametrize("lambda_g", [0.0, 0.06, 1.0])
@every_frame
def test_regularised(frame: Frame, lambda_g: float) -> None:
    """A loss is asked twice, as the second time it must not remember the first."""
    loss, exact = (each.regularised(frame, image(0), lambda_g) for each in (KERNELS, REFERENCE))
    for gaussians in (over(frame, 0), over(frame, 1)):
        with torch.no_grad():  # as a caller of PyTorch may have it
            mse, gradient = loss(gaussians)
        wanted_mse, wanted = exact(gaussians)
        assert mse == pytest.approx(wanted_mse, rel=3e-6)  # worst seen 8.3e-7
        for by, wanted_by in zip(gradient.arrays, wanted.arrays, strict=True):
            assert worst(by, wanted_by) < 1e-5  # worst seen 4.6e-6


@each_visibility
@every_frame
def test_gram(frame: Frame, backend: Backend, kind: str) -> None:
    asked = over(frame, 0), frame, visibility(kind, 0)
    assert worst(backend.gram(*asked), REFERENCE.gram(*asked)) < 1e-5  # worst seen 3.4e-6


@pytest.mark.parametrize("backend", [*BACKENDS.values(), REFERENCE], ids=[*BACKENDS, "reference"])
@every_frame
def test_without_gaussians(frame: Frame, backend: Backend) -> None:
    none, wanted = Gaussians.empty(0), target(0)
    mean = float(np.square(image(0), dtype=np.float64).mean())
    assert backend.error(none, frame, wanted) == pytest.approx(mean, rel=1e-3)  # the target is rounded
    levels = (wanted / TARGET_WHITE).astype(np.float32)
    assert worst(backend.residual(none, frame, wanted), levels) < 2e-7  # worst seen 6e-8
    assert [len(by) for by in backend.gradients(none, frame, wanted)[1].arrays] == [0, 0, 0]
    assert backend.gram(none, frame).shape == (0, 3)
