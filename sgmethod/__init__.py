"""sgmethod: an image codec that stores photographs as 2D Gaussians.

        sgmethod.encode("photo.jpg", bpp=0.3).save("photo.sg")
        pixels = sgmethod.decode("photo.sg")  # uint8 [H, W, 3]

Read codec.py first, which turns a picture into a file; then rd/encode.py, the stages of an encode, and the modules
that it imports; then decoder.py, the way back. CONTRIBUTING.md follows one encode through them.

The packages and modules, in the order of the pipeline; each imports only from those above it:

    errors      the tree of errors
    opencv      OpenCV, or how to install it
    arguments   checks of callers' numbers
    budget      what an encode may spend
    trace       progress of an encode
    machine     the cores and the memory that this process may use
    numerics    arithmetic that ignores floating-point errors
    scene       the set of Gaussians
    settings/   what efforts, previews and experiments choose
    profiles    names of profiles, tunings and efforts
    native/     compiled kernels: drawing, gradients, entropy coding
    backend/    the protocol through which the encoder draws, differentiates and refines
    threads     the number of threads; NumPy and OpenCV on as many as the kernels use
    io/         image files -> arrays; arrays -> image files; whole files
    bitstream/  Gaussians <-> bytes, one module for each version of the format
    view        drawing any part at any size
    decoder     bytes -> Gaussians -> pixels
    metrics/    PSNR, SSIMULACRA 2; whether another format does better
    encode_arguments  an encode's arguments, checked
    fitting/    the picture at every size, the objective, the deadline
    paper/      profile paper
    rd/         profile rd
    encoded     the result of an encode, with the figures of the decoded file
    codec       encode(): runs a profile's pipeline
    previews/   a picture -> a text of a few hundred characters, for web pages
    many/       any number of pictures, in several processes, with a manifest
    exchange/   a caller's Gaussians -> an .sg file; PLY and npz files
    pillow/     .sg files for Pillow
    client/     client of an encoding service
    cli/        the command line
    torch/      tensors: the differentiable renderer, fits on GPUs, files, data sets

javascript/ holds the decoder for browsers, `<sg-img>`, and the npm package of both.

Decoding needs only NumPy, Pillow and the compiled kernels; profile paper and sgmethod.torch import
PyTorch. Importing this package lets Pillow open and save .sg files.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from sgmethod.pillow import plugin

if TYPE_CHECKING:
    from sgmethod.bitstream.stream import Info as Info
    from sgmethod.bitstream.text import from_text as from_text, to_text as to_text
    from sgmethod.budget import Budget as Budget
    from sgmethod.codec import encode as encode
    from sgmethod.decoder import SgFile as SgFile, decode as decode, info as info, open as open
    from sgmethod.encoded import Encoded as Encoded, Stats as Stats
    from sgmethod.errors import (
        BitstreamError as BitstreamError,
        BudgetError as BudgetError,
        GaussiansError as GaussiansError,
        ImageError as ImageError,
        ImageWarning as ImageWarning,
        MissingPackageError as MissingPackageError,
        NativeModuleError as NativeModuleError,
        ServerError as ServerError,
        SgError as SgError,
        ViewError as ViewError,
    )
    from sgmethod.exchange.packing import pack as pack
    from sgmethod.exchange.ply_and_npz import (
        read_npz as read_npz,
        read_ply as read_ply,
        write_npz as write_npz,
        write_ply as write_ply,
    )
    from sgmethod.many.encode_many import encode_many as encode_many
    from sgmethod.many.manifest import Row as Row
    from sgmethod.many.run import Tally as Tally
    from sgmethod.previews.preview import Preview as Preview, preview as preview
    from sgmethod.scene import Gaussians as Gaussians
    from sgmethod.threads import set_threads as set_threads
    from sgmethod.trace import TracePoint as TracePoint
    from sgmethod.view import View as View

    __version__: str

# Imported on first use: numpy takes 0.1 s, torch more.
_HOMES = {
    "bitstream.stream": ("Info",),
    "bitstream.text": ("from_text", "to_text"),
    "budget": ("Budget",),
    "codec": ("encode",),
    "decoder": ("SgFile", "decode", "info", "open"),
    "encoded": ("Encoded", "Stats"),
    "errors": (
        *("BitstreamError", "BudgetError", "GaussiansError", "ImageError", "ImageWarning", "MissingPackageError"),
        *("NativeModuleError", "ServerError", "SgError", "ViewError"),
    ),
    "exchange.ply_and_npz": ("read_npz", "read_ply", "write_npz", "write_ply"),
    "exchange.packing": ("pack",),
    "many.encode_many": ("encode_many",),
    "many.manifest": ("Row",),
    "many.run": ("Tally",),
    "previews.preview": ("Preview", "preview"),
    "scene": ("Gaussians",),
    "threads": ("set_threads",),
    "trace": ("TracePoint",),
    "view": ("View",),
}
_HOME = {name: home for home, names in _HOMES.items() for name in names}
# All but `open`: `from sgmethod import *` must replace no builtin.
__all__ = sorted(_HOME.keys() - {"open"})  # noqa: PLE0605 - a list of names, each of which is imported above

plugin.register()


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from importlib.metadata import version

        return version("sgmethod")
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(importlib.import_module(f"{__name__}.{_HOME[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *_HOME, "__version__"})
