"""The compiled kernels: superpixels, drawing, gradients, the optimiser's step, the entropy coder, refining.

Arguments are NumPy arrays, and results are written to arrays provided by the caller. The C++ sources lie beside this
file, in folders that include and link only those before them: core/ (constants, threads, vectors), start/
(superpixels), texture/ (noise from a seed), raster/ (drawing), fit/ (gradients, loss, optimisers), rd/ (profile rd:
integers, entropy coder) and refine/ (search over the integers, one Gaussian at a time) know nothing of Python.
bindings/ is the interface to Python.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NoReturn

from sgmethod.errors import NativeModuleError


class _Missing:
    """A placeholder for kernels that cannot be loaded: fails on first use, so that imports and --help still work."""

    def __init__(self, error: ImportError) -> None:
        self._error = error

    def __getattr__(self, _name: str) -> NoReturn:
        raise NativeModuleError(
            f"the compiled part of sgmethod cannot be loaded ({self._error}); "
            "in a checkout, run: pip install --editable .; elsewhere, install sgmethod again"
        ) from self._error


if TYPE_CHECKING:
    from sgmethod.native import _native as native
else:
    try:
        from sgmethod.native import _native as native
    except ImportError as error:
        native = _Missing(error)

__all__ = ["native"]
