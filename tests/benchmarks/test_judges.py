"""Metrics that chose nothing, where they are installed: which way they point, and that they need no network."""

from __future__ import annotations

import shutil
import socket
import warnings
from importlib.util import find_spec

import pytest

from benchmarks.perceptual.judges import BUTTERAUGLI, Judges
from tests.metrics.test_metrics import disturbed, picture

pytestmark = pytest.mark.thorough
SOURCE = picture(80, 96)


def test_judges(monkeypatch: pytest.MonkeyPatch) -> None:
    if find_spec("pycvvdp") is None or shutil.which(BUTTERAUGLI) is None:
        pytest.skip("needs the extra judges and libjxl-devtools")
    monkeypatch.setattr(socket.socket, "connect", lambda *_: pytest.fail("the judges ask the network"))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of their own code
        judges = Judges()
        same, little, more = (judges(disturbed(SOURCE, k) if k else SOURCE, SOURCE) for k in (0, 5, 60))
    assert same == {"butteraugli": 0, "cvvdp": 10}
    assert same["butteraugli"] < little["butteraugli"] < more["butteraugli"]
    assert same["cvvdp"] > little["cvvdp"] > more["cvvdp"]
