"""The constants of the compiled module are those of docs/format.md."""

from __future__ import annotations

import numpy as np

from sgmethod.native import native


def test_constants_are_those_of_the_format() -> None:
    assert native.MAX_SIDE == 65_535
    assert (native.CUTOFF_V1, native.CUTOFF_V3, native.MAX_CUTOFF) == (5.5, 3.0, 5.5)
    assert (native.MIN_SCALE, native.COLOR_SCALE, native.R_STEP) == (0.3, 1.5, 2.0)


def test_the_colour_axes_are_orthonormal() -> None:
    basis = np.array(native.COLOR_BASIS)
    assert np.abs(basis @ basis.T - np.eye(3)).max() < 1e-15  # worst seen 2.2e-16
    assert (basis[0] > 0).all()
