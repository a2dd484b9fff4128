"""Profile paper: the method of the paper, and the format of its files (stream.py, docs/paper-format.md).

A picture is encoded by a structure-guided start, a fit and quantisation-aware tuning. Reading a file needs no PyTorch.
"""

from sgmethod.paper.settings import PAPER
from sgmethod.profiles import Method

METHOD = Method(
    PAPER,
    encoder="sgmethod.paper.encode.encode",
    smallest_file="sgmethod.paper.stream.smallest_file",
    tunes=("psnr",),
    kinds=("bpp", "bytes", "psnr", "gaussians"),
    keeps_alpha=False,
    packages=("torch", "skimage"),
)
