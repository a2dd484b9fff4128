"""The compiled kernels: drawing, gradients, the optimiser's step, the entropy coder, refining.

Arguments are NumPy arrays, and results are written to arrays provided by the caller. Tensors would be accepted too, but
torch exports their memory in Python code, and an interrupt that arrives there is lost: the binding takes any error for
"not an array of this kind". The build writes the module's types (_native.pyi) beside it. The C++ sources lie beside
this file, in folders that include and link only those before them: core/ (constants, threads, vectors),
texture/ (noise from a seed), raster/ (drawing), fit/ (gradients, loss, optimisers), rd/ (profile rd:
integers, entropy coder) and refine/ (search over the integers, one Gaussian at a time) know nothing of Python.
bindings/ is the interface to Python.

Read core/gaussians.h first, then how a picture is drawn (raster/rasterization.h and raster/drawing.cpp), how a file is
read and written (rd/symbols.h and rd/codec.cpp), how a fit moves (fit/gradients.cpp and rd/steps.cpp), and how integers
are chosen (refine/refine.cpp). Each header says what its .cpp does.
"""

from __future__ import annotations

import os
import re
from typing import TYPE_CHECKING, Any, NoReturn

from sgmethod import machine
from sgmethod.errors import NativeModuleError

ISAS = ("baseline", "avx2", "avx512")  # as core/isa.h numbers them


class _Missing:
    """A placeholder for kernels that cannot be loaded: fails on first use, so that imports and --help still work."""

    def __init__(self, why: str) -> None:
        self._why = why

    def __getattr__(self, _name: str) -> NoReturn:
        raise NativeModuleError(self._why)


def _set_up(kernels: Any) -> Any:
    """Return the kernels, with a thread for each core or SG_THREADS, and no better instruction set than SG_ISA."""
    text = os.environ.get("SG_THREADS", "")
    cores = machine.cores()  # more threads would wait for each other
    asked = int(text) if re.fullmatch("0*[1-9][0-9]{0,8}", text, re.ASCII) else cores
    kernels.set_thread_count(min(asked, cores))
    name = os.environ.get("SG_ISA", "")
    if name:
        known = ISAS[: kernels.best_isa() + 1]
        if name not in known:
            return _Missing(f"SG_ISA must be {' or '.join(known)} on this processor, not {name[:40]!r}")
        kernels.limit_isa(known.index(name))
    return kernels


if TYPE_CHECKING:
    from sgmethod.native import _native as native
else:
    try:
        from sgmethod.native import _native
    except ImportError as error:
        native = _Missing(
            f"the compiled part of sgmethod cannot be loaded ({error}); "
            "in a checkout, run: pip install --editable .; elsewhere, install sgmethod again"
        )
    else:
        native = _set_up(_native)

__all__ = ["native"]
