"""sgmethod: photographs as small sets of 2D Gaussians.

The pipeline, in the order in which it runs; each module imports only from those above it:

    errors      the tree of errors
    budget      what an encode may spend
    trace       what a fit reports while it runs
    image       image files -> arrays
    files       PNG and other results -> files, whole or absent
    profiles    every number of the method
    gaussians   the set of Gaussians
    native_module, native/   compiled kernels: rendering, its gradients, the loss
    reference   the renderer's definition, slow on purpose
    render      the differentiable renderer for torch
    structure   gradients, regions, complexity of a picture
    placement   structure-guided start
    bitstream   version 1 of the file (profiles paper, baseline): syntax elements <-> bytes
    bitstream_rd  version 3 (profile rd)
    view        any size, any part
    decode      bytes -> Gaussians -> pixels
    metrics     PSNR, MS-SSIM
    fit         the optimiser, its schedule and its trace
    quantise/   quantisers: lattice, codebook and paper (LSQ, ABQ, RVQ), rd (steps from sensitivity, rate)
    growth      where another Gaussian would pay
    paper       profiles paper and baseline
    rd_finish   profile rd, from fitted Gaussians to the file that meets the goal best
    rd          profile rd: how many Gaussians, where and how fine
    codec       encode(): a profile, then the measured result
    client      the same encode by a service elsewhere
    terminal    what the command line shows
    cli         the command line

Decoding needs numpy and the compiled kernels only; torch is imported by encode() alone.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from sgmethod.budget import Budget
from sgmethod.decode import decode, info
from sgmethod.errors import BitstreamError, BudgetError, ImageError, NativeModuleError, SgError, ViewError
from sgmethod.native_module import native
from sgmethod.trace import TracePoint
from sgmethod.view import View

if TYPE_CHECKING:
    from sgmethod.codec import Encoded, Stats, encode

__all__ = [
    "BitstreamError",
    "Budget",
    "BudgetError",
    "Encoded",
    "ImageError",
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
    """Threads that rendering and fitting use in this process, at least 1; SG_THREADS sets it at the start,
    else it is the number of cores this process may run on."""
    native.set_thread_count(count)


def __getattr__(name: str) -> Any:
    if name in ("encode", "Encoded", "Stats"):
        from sgmethod import codec

        return getattr(codec, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
