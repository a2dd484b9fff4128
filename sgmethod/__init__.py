"""sgmethod: photographs as small sets of 2D Gaussians.

The rooms and modules, in the order of the pipeline; each imports only from those above it:

    errors      the tree of errors
    budget      what an encode may spend
    trace       what an encode reports while it runs
    scene       the set of Gaussians
    profiles    every number of the method
    native/     compiled kernels: drawing, gradients, entropy coding
    io/         image files -> arrays; arrays -> PNG; whole files
    bitstream/  Gaussians <-> bytes, one module for each version of the format
    view        any size, any part
    decode      bytes -> Gaussians -> pixels
    metrics     PSNR, MS-SSIM
    start/      structure of the picture -> Gaussians to start from
    fitting/    the picture and its loss, the optimiser, its schedule
    paper/      profiles paper and baseline
    rd/         profile rd
    codec       encode(): a profile's pipeline, then the decoded result measured
    client/     the same encode by a service elsewhere
    cli/        the command line

Decoding needs numpy and the compiled kernels only; torch is imported by encode() alone.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from sgmethod.bitstream.stream import Info
from sgmethod.budget import Budget
from sgmethod.decode import decode, info
from sgmethod.errors import BitstreamError, BudgetError, ImageError, NativeModuleError, SgError, ViewError
from sgmethod.native import native as _native
from sgmethod.trace import TracePoint
from sgmethod.view import View

if TYPE_CHECKING:
    from sgmethod.codec import Encoded, Stats, encode

    __version__: str

__all__ = [
    "BitstreamError",
    "Budget",
    "BudgetError",
    "Encoded",
    "ImageError",
    "Info",
    "NativeModuleError",
    "SgError",
    "Stats",
    "TracePoint",
    "View",
    "ViewError",
    "decode",
    "encode",
    "info",
    "set_threads",
]


def set_threads(count: int) -> None:
    """Threads that rendering and fitting use in this process, 1 to 256. SG_THREADS sets it at the start; else it is the
    number of cores that this process may run on and its control group's quota allows."""
    _native.set_thread_count(count)


def __getattr__(name: str) -> Any:
    """What takes its time to import, once it is asked for."""
    if name == "__version__":
        from importlib.metadata import version

        return version("sgmethod")
    if name in ("encode", "Encoded", "Stats"):
        from sgmethod import codec

        return getattr(codec, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
