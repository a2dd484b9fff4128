"""The compiled module's constants are those of docs/format.md, its names those of its stub."""

from __future__ import annotations

import ast

import numpy as np

from sgmethod.native import native
from tests.support.data import ROOT

STUB = ROOT / "sgmethod" / "native" / "_native.pyi"


def test_constants_are_those_of_the_format() -> None:
    assert native.MAX_SIDE == 65_535
    assert (native.CUTOFF_V1, native.CUTOFF_V2) == (5.5, 3.0)
    assert (native.COLOR_SCALE, native.R_STEP) == (1.5, 2.0)
    assert (native.MAX_LEVEL, native.NARROWEST) == (12, 1.4)


def test_the_colour_axes_are_orthonormal() -> None:
    basis = np.array(native.COLOR_BASIS)
    assert np.abs(basis @ basis.T - np.eye(3)).max() < 1e-15  # worst seen 2.2e-16
    assert (basis[0] > 0).all()


def test_the_stub_has_the_modules_names() -> None:
    tree = ast.parse(STUB.read_text()).body
    named = {node.name for node in tree if isinstance(node, ast.FunctionDef | ast.ClassDef)}
    constants = {
        node.target.id for node in tree if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name)
    }
    assert named | constants == {name for name in dir(native) if not name.startswith("_")}
