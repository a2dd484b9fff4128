"""Types of the compiled module (sgmethod/native/bindings/). Arrays are C-contiguous float32.

Only numpy's are typed, though tensors would be taken: torch hands its memory over in Python code, where an interrupt
that arrives is lost, because the binding takes any error there for "not an array of this kind".
"""

import numpy as np
from numpy.typing import NDArray

from sgmethod.scene import FloatArray

MAX_SIDE: int  # pixels along a side of a picture
CUTOFF_V1: float  # sigma at which a Gaussian of version 1 ends
CUTOFF_V2: float  # and of version 2
MAX_CUTOFF: float  # the largest that the kernels take
MIN_SCALE: float  # pixels; l1 and l3 are at least this
COLOR_BASIS: tuple[tuple[float, float, float], tuple[float, float, float], tuple[float, float, float]]
"""Orthonormal axes of a colour in profile rd, one a row: luma-like, and two chroma-like."""
COLOR_SCALE: float
"""A colour's step in profile rd is quantum / (COLOR_SCALE s), with s the Gaussian's size in pixels."""
R_STEP: float  # the step of r = l2 / l3 over that of v = log sqrt(l1 / l3) in profile rd
TARGET_WHITE: int  # in the target of a fit, int16 [3, height, width]
TEXTURE_OCTAVES: int
TEXTURE_CELL: int  # pixels of the picture along a side of a cell
TEXTURE_STRENGTHS: int  # codes of a strength; 0 is none
VISIBLE: int  # 1 in the visibility of a picture's errors, int16 [height, width]
SEEN_COLOR: float
SEEN_LUMA: tuple[float, float, float]
"""To the eye an error e [3] counts SEEN_COLOR |e|^2 + (SEEN_LUMA e)^2, times its pixel's visibility."""
TILE_WIDTH: int
TILE_HEIGHT: int

def best_isa() -> int:
    """0 baseline x86-64, 1 AVX2, 2 AVX-512: the best this processor has."""

def available_cores() -> int:
    """Cores this process may use: its affinity, cut by the processor quotas of its control groups; at least 1."""

def thread_count() -> int:
    """Threads that kernels use, the calling one included. Fewer run where the system refuses to create them."""

def set_thread_count(count: int) -> None: ...
def release_memory() -> None:
    """Give back to the system what is kept of freed memory: before work that needs other sizes."""

def most_pairs(gaussians: int, width: int, height: int) -> int:
    """The most pairs of Gaussian and tile that a picture needs: beyond, a file is hostile."""

def unpack_texture(data: bytes, width: int, height: int) -> tuple[NDArray[np.uint8], int]:
    """The codes of a picture's texture [TEXTURE_OCTAVES, rows, columns], and how many bytes say them. Raises
    RuntimeError for what no encoder writes."""

class Texture:
    """Noise from a seed (sgmethod/native/texture/texture.h). Raises ValueError for codes and cells that cannot be."""

    def __init__(
        self,
        codes: NDArray[np.uint8],
        cell_x: float,
        cell_y: float,
        x: float = 0.0,
        y: float = 0.0,
        shift: int = 0,
    ) -> None:
        """codes [TEXTURE_OCTAVES, rows, columns] below TEXTURE_STRENGTHS; cell_x, cell_y: sides of a cell, and x, y:
        the picture's corner, in output pixels; shift: octave o is drawn on level o + shift."""

class Rasterization:
    """Gaussians' geometry laid over a pixel grid. Raises OverflowError beyond max_pairs pairs of Gaussian and tile."""

    def __init__(
        self,
        means: FloatArray,
        factors: FloatArray,
        width: int,
        height: int,
        cutoff: float = 5.5,
        isa: int = -1,
        max_pairs: int = 2**31 - 1,
        pyramid: bool = False,
        x: int = 0,
        y: int = 0,
        texture: Texture | None = None,
    ) -> None:
        """pyramid: wide Gaussians are drawn on coarser levels (sgmethod/native/raster/levels.h). x, y: the first pixel
        that is drawn, so that a part is the same as in the whole. texture: is drawn with them, in a pyramid alone."""

    @property
    def width(self) -> int: ...
    @property
    def height(self) -> int: ...
    def render(self, colors: FloatArray, image: FloatArray) -> None:
        """Fill image [3, height, width]."""

    def missing(self, colors: FloatArray, target: NDArray[np.int16], image: FloatArray) -> None:
        """Fill image [3, height, width]: target, in which white is TARGET_WHITE, less the picture, in which it is 1."""

    def render_bytes(
        self, colors: FloatArray, image: NDArray[np.uint8], background: tuple[float, float, float] = (0.0, 0.0, 0.0)
    ) -> None:
        """Fill image [height, width, 3], uint8: background plus Gaussians."""

    def squared_error(
        self,
        colors: FloatArray,
        target: NDArray[np.int16],
        means: FloatArray,
        factors: FloatArray,
        out_colors: FloatArray,
        visibility: NDArray[np.int16] | None = None,
        by_eye: bool = True,
    ) -> float:
        """The mean squared error against a target; fills its gradients as backward does. With a visibility each pixel
        counts so much, and colours as the eye sees them or, without by_eye, alike."""

    def error(self, colors: FloatArray, target: NDArray[np.int16]) -> float:
        """The mean squared error against a target."""

    def gram(self, colors: FloatArray, out_colors: FloatArray, visibility: NDArray[np.int16] | None = None) -> None:
        """Fill out_colors [N, 3]: each Gaussian's product with the picture that all draw, times the visibility."""

    def backward(
        self, colors: FloatArray, grad: FloatArray, means: FloatArray, factors: FloatArray, out_colors: FloatArray
    ) -> None:
        """Fill the gradients by means [N, 2], factors [N, 3] and colours [N, 3], given that by the image."""

class ReconstructionLoss:
    """MSE + lambda_g L_g against a target [3, height, width]."""

    def __init__(self, target: FloatArray, lambda_g: float) -> None: ...
    def __call__(self, image: FloatArray, grad: FloatArray) -> tuple[float, float]:
        """(MSE, L_g); fills grad with the gradient by the image."""

class AdamSettings:
    """Of frame_adam; rates are relative changes of a step."""

    def __init__(
        self,
        mean_rate: float,
        factor_rate: float,
        color_rate: float,
        beta1: float,
        beta2: float,
        min_scale: float,
        newton_steps: float,
        values: float,
    ) -> None: ...

def frame_adam(
    settings: AdamSettings,
    rate: float,
    means: FloatArray,
    factors: FloatArray,
    colors: FloatArray,
    by_means: FloatArray,
    by_factors: FloatArray,
    by_colors: FloatArray,
    first: FloatArray,
    second: FloatArray,
    bias: FloatArray,
) -> None:
    """Backend.step (sgmethod/backend/protocol.py): moves the Gaussians; updates first, second [N, 8], bias [N, 2]."""

def keep_in_range(
    reach: float, width: float, height: float, means: FloatArray, factors: FloatArray, colors: FloatArray
) -> None:
    """Keep Gaussians where every file can say them: scale, slant and amplitude, and means within reach sqrt(l1 l3) of
    the picture."""

def rd_rate_gradient(
    quantum: float,
    weight: float,
    factors: FloatArray,
    colors: FloatArray,
    by_factors: FloatArray,
    by_colors: FloatArray,
) -> None:
    """Backend.add_rate_gradient (sgmethod/backend/protocol.py): adds to by_factors and by_colors."""

class RdParameters:
    """What the stream of profile rd needs to know before its first Gaussian."""

    def __init__(
        self,
        width: int,
        height: int,
        quantum: float,
        grey: bool = False,
        upright: bool = False,
        is_short: bool = False,
    ) -> None:
        """is_short: whether all symbols share one state, as in a short file."""

def rd_clipped_values() -> int:
    """Values that lay outside of the range of their integer and were moved to its end, since the process began: of
    Gaussians that came to be quantised, encoded or refined."""

def rd_quantise(
    parameters: RdParameters,
    means: FloatArray,
    factors: FloatArray,
    colors: FloatArray,
    out_means: FloatArray,
    out_factors: FloatArray,
    out_colors: FloatArray,
) -> None:
    """Fill out_* with what decoding an encoding would give; colour 0 where nothing of a Gaussian is left."""

def rd_encode(parameters: RdParameters, means: FloatArray, factors: FloatArray, colors: FloatArray) -> bytes: ...
def rd_refine(
    parameters: RdParameters,
    means: FloatArray,
    factors: FloatArray,
    colors: FloatArray,
    target: NDArray[np.int16],
    cutoff: float,
    price: float,
    sweeps: int,
    seconds: float,
    max_bytes: int,
    visibility: NDArray[np.int16] | None = None,
    by_eye: bool = True,
    halvings: int = 0,
) -> bytes:
    """The payload of the Gaussians, their integers refined one Gaussian at a time (sgmethod/native/refine/refine.h).
    visibility, by_eye: as in squared_error(); halvings: of the picture, that make the target."""

def rd_lay_out(
    parameters: RdParameters, data: bytes, prefix: bool, texture: Texture | None = None
) -> tuple[Rasterization, FloatArray]:
    """The Gaussians of a payload laid over the whole picture, and their colours. The first are laid out while others
    are still decoded. Raises as rd_decode() and Rasterization do, and beyond most_pairs() pairs."""

def rd_decode(
    parameters: RdParameters, data: bytes, prefix: bool = False, max_gaussians: int = ...
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """(means, factors, colors); raises RuntimeError on data no encoder writes, OverflowError for more than
    max_gaussians. prefix: data may be cut anywhere."""
