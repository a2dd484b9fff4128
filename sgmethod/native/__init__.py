"""The compiled kernels: drawing, gradients, the optimiser's step, the entropy coder, refining.

Arrays of numpy come in, and results leave in arrays that the caller brings.
The C++ sources lie beside this file, in rooms that include and link those before them alone: core/ (constants,
threads, vectors), texture/ (noise from a seed), raster/ (drawing), fit/ (gradients, loss, optimisers), rd/ (profile
rd: integers, entropy coder) and refine/ (the integers of one Gaussian at a time) know nothing of Python. bindings/
translates for Python.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NoReturn

from sgmethod.errors import NativeModuleError


class _Missing:
    """Stands in for kernels that cannot be loaded, until one is needed: imports and --help do without."""

    def __init__(self, error: ImportError) -> None:
        self._error = error

    def __getattr__(self, _name: str) -> NoReturn:
        raise NativeModuleError(
            f"the compiled part of sgmethod cannot be loaded ({self._error}); "
            "build it with: pip install --editable . inside a checkout, or pip install --force-reinstall ."
        ) from self._error


if TYPE_CHECKING:
    from sgmethod.native import _native as native
else:
    try:
        from sgmethod.native import _native as native
    except ImportError as error:
        native = _Missing(error)

__all__ = ["native"]
