"""Types of the compiled module (sgmethod/native/bindings/). Arrays are C-contiguous float32.

Only NumPy arrays are typed, although tensors would be accepted: torch exports its memory in Python code, and an
interrupt that arrives there is lost, because the binding takes any error for "not an array of this kind".
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from sgmethod.scene import FloatArray

MAX_SIDE: int  # pixels along a side of a picture
CUTOFF_V1: float  # sigma at which a Gaussian of version 1 ends
CUTOFF_V2: float  # and of version 2
COLOR_BASIS: tuple[tuple[float, float, float], tuple[float, float, float], tuple[float, float, float]]
"""Orthonormal axes of a colour in profile rd, one per row: luma-like, and two chroma-like."""
COLOR_SCALE: float
"""A colour's step in profile rd is quantum / (COLOR_SCALE s), with s the Gaussian's size in pixels."""
R_STEP: float  # ratio of the steps of r = l2 / l3 and v = log sqrt(l1 / l3) in profile rd
TARGET_WHITE: int  # in the target of a fit, int16 [3, height, width]
TEXTURE_OCTAVES: int
TEXTURE_CELL: int  # pixels of the picture along a side of a cell
TEXTURE_STRENGTHS: int  # codes of a strength; 0 is none
VISIBLE: int  # 1 in the visibility of a picture's errors, int16 [height, width]
COARSE_SIDE: int  # pixels along a side of the squares whose mean errors may count once more
SEEN_COLOR: float
SEEN_LUMA: tuple[float, float, float]
"""Weights for the eye: an error e [3] counts SEEN_COLOR |e|^2 + (SEEN_LUMA e)^2, times its pixel's visibility."""
TILE_WIDTH: int
TILE_HEIGHT: int
MAX_LEVEL: int  # of the pyramid
NARROWEST: float  # least minor axis of a Gaussian on a level above 0, in samples
MAX_SCALE: float  # of l1 and l3 during a fit, in pixels
MAX_SLANT: float  # of |l2| / l3 during a fit
MAX_AMPLITUDE: float  # of each colour during a fit
FAINT: float  # least |colour|^2 in a step

def limit_isa(isa: int) -> None: ...
def best_isa() -> int:
    """Best instruction set of this processor: 0 the baseline, 1 AVX2, 2 AVX-512."""

def available_cores() -> int:
    """Cores this process may use: its affinity, limited by the CPU quotas of its control groups; at least 1."""

def thread_count() -> int:
    """Threads used by kernels, including the calling one; fewer if the system refuses to create them."""

def set_thread_count(count: int) -> None: ...
def in_parallel(count: int, task: Callable[[int], None]) -> None:
    """Call task(0) to task(count - 1) on the kernels' threads; after an error, skip those that have not begun."""

def stay_alone() -> None:
    """From now on run the calling thread's kernels on it alone, at the same time as other threads run theirs."""

def release_memory() -> None:
    """Return cached free memory to the system, before work that needs other sizes."""

def max_pairs_of(gaussians: int, width: int, height: int) -> int:
    """Most pairs of Gaussian and tile that a picture may need; a file that needs more is hostile."""

def unpack_texture(data: bytes, width: int, height: int) -> tuple[NDArray[np.uint8], int]:
    """Decode a picture's texture codes [TEXTURE_OCTAVES, rows, columns]; also return the number of bytes read.

    Raises RuntimeError for data that no encoder writes.
    """

class Texture:
    """Noise from a seed (sgmethod/native/texture/texture.h). Raises ValueError for invalid codes and cells."""

    def __init__(
        self, codes: NDArray[np.uint8], cell_x: float, cell_y: float, x: float = 0.0, y: float = 0.0, shift: int = 0
    ) -> None:
        """Take codes [TEXTURE_OCTAVES, rows, columns] below TEXTURE_STRENGTHS.

        cell_x, cell_y: sides of a cell, and x, y: the picture's corner, in output pixels; shift: octave o is drawn on
        level o + shift.
        """

class Rasterization:
    """Gaussians' geometry on a pixel grid. Raises OverflowError for more than max_pairs pairs of Gaussian and tile."""

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
        """Assign Gaussians to tiles.

        pyramid: wide Gaussians are drawn on coarser levels (sgmethod/native/raster/levels.h); x, y: the first pixel
        drawn, so that a part looks as in the whole picture; texture: drawn too, only with a pyramid.
        """

    @property
    def width(self) -> int: ...
    @property
    def height(self) -> int: ...
    def render(self, colors: FloatArray, image: FloatArray) -> None:
        """Fill image [3, height, width]."""

    def missing(self, colors: FloatArray, target: NDArray[np.int16], image: FloatArray) -> None:
        """Fill image [3, height, width], 1 being white: target, in which white is TARGET_WHITE, minus the picture."""

    def missing_halved(self, colors: FloatArray, target: NDArray[np.int16], image: FloatArray) -> None:
        """Fill image at half the size with means of four of missing(). A part must begin with a whole tile."""

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
        coarse: float = 0.0,
        spacing: int = 1,
    ) -> float:
        """Mean squared error against a target; fills its gradients like backward().

        visibility: weights of the pixels' errors; by_eye: colours count as the eye sees them, else alike; coarse:
        weight with which mean errors over squares of 4 pixels of the whole picture count once more; spacing: side of a
        pixel, in those of the whole picture.
        """

    def error(self, colors: FloatArray, target: NDArray[np.int16]) -> float:
        """Mean squared error against a target."""

    def gram(self, colors: FloatArray, out_colors: FloatArray, visibility: NDArray[np.int16] | None = None) -> None:
        """Fill out_colors [N, 3]: inner product of each Gaussian with the picture of all, weighted by visibility."""

    def backward(
        self, colors: FloatArray, grad: FloatArray, means: FloatArray, factors: FloatArray, out_colors: FloatArray
    ) -> None:
        """Backpropagate a gradient by the image: fill those by means [N, 2], factors [N, 3] and colours [N, 3]."""

class ReconstructionLoss:
    """MSE + lambda_g L_g against a target [3, height, width]."""

    def __init__(self, target: FloatArray, lambda_g: float) -> None: ...
    def __call__(self, image: FloatArray, grad: FloatArray) -> float:
        """Return the MSE alone; fill grad with the gradient of both by the image."""

class AdamSettings:
    """Settings of frame_adam(); rates are relative changes per step."""

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
    visibility: NDArray[np.int16] | None = None,
    spacing: float = 1.0,
    coarse: float = 0.0,
) -> None:
    """Move Gaussians, and update first, second [N, 8] and bias [N, 2]: Kernels.step (backend/kernels.py)."""

def keep_in_range(
    reach: float, width: float, height: float, means: FloatArray, factors: FloatArray, colors: FloatArray
) -> None:
    """Clamp scale, slant and amplitude to the limits of a fit, and means to within reach sqrt(l1 l3) of the picture."""

def squared_difference(a: NDArray[np.uint8], b: NDArray[np.uint8]) -> int:
    """Sum of squared differences of values [N]."""

def seen_difference(
    a: NDArray[np.uint8], b: NDArray[np.uint8], visibility: NDArray[np.int16], by_eye: bool, coarse: float = 0.0
) -> float:
    """VISIBLE times the squared difference of pictures [height, width, 3], as the visibility counts it."""

def to_amplitudes(planes: FloatArray, visibility: NDArray[np.int16], root: FloatArray | None) -> None:
    """Scale an error's planes [3, height, width], in place, so that their squares are the error as it is seen.

    root [9]: square root of the weights of channels; None if all count alike.
    """

def gains(
    red: FloatArray,
    green: FloatArray,
    blue: FloatArray,
    sigmas: FloatArray,
    scales: FloatArray,
    gain: FloatArray,
    chosen: NDArray[np.uint8],
    isa: int = -1,
) -> None:
    """Blur a residual's planes [height, width], mirrored at their edges, by each sigma [N].

    gain [height, width]: the largest of a scale times the sum of the blurred planes' squares; chosen: whose it is.
    """

def superpixels(lab: FloatArray, side: int, compactness: float) -> NDArray[np.int32]:
    """Labels [height, width] of an image [3, height, width] in CIELAB, as cv2.ximgproc's SLIC has them."""

def rd_rate_gradient(
    quantum: float,
    weight: float,
    factors: FloatArray,
    colors: FloatArray,
    by_factors: FloatArray,
    by_colors: FloatArray,
) -> None:
    """Add a gradient to by_factors and by_colors: Kernels.add_rate_gradient (sgmethod/backend/kernels.py)."""

def rd_steps(
    target: NDArray[np.int16],
    cutoff: float,
    pyramid: bool,
    spacing: float,
    quantum: float,
    price: float,
    settings: AdamSettings,
    rates: FloatArray,
    reach: float,
    width: float,
    height: float,
    means: FloatArray,
    factors: FloatArray,
    colors: FloatArray,
    first: FloatArray,
    second: FloatArray,
    bias: FloatArray,
    visibility: NDArray[np.int16] | None = None,
    by_eye: bool = True,
    coarse: float = 0.0,
) -> list[float]:
    """Take a step for each of the rates: Backend.steps (sgmethod/backend/protocol.py)."""

class RdParameters:
    """Parameters of profile rd's stream that are known before its first Gaussian."""

    def __init__(
        self, width: int, height: int, quantum: float, grey: bool = False, upright: bool = False, is_short: bool = False
    ) -> None:
        """Describe a payload. is_short: whether all symbols share one state, as in a short file."""

def rd_clipped_values() -> int:
    """Number of values clamped to the range of their integers in this process, while Gaussians were quantised."""

def rd_quantise(
    parameters: RdParameters,
    means: FloatArray,
    factors: FloatArray,
    colors: FloatArray,
    out_means: FloatArray,
    out_factors: FloatArray,
    out_colors: FloatArray,
) -> int:
    """Fill out_* with Gaussians as a decoder would see them, with colour 0 if one rounds to nothing.

    Returns the number of values clamped to the range of their integers.
    """

def rd_encode(parameters: RdParameters, means: FloatArray, factors: FloatArray, colors: FloatArray) -> bytes: ...
def rd_refine(
    parameters: RdParameters,
    means: FloatArray,
    factors: FloatArray,
    colors: FloatArray,
    target: NDArray[np.int16],
    price: float,
    sweeps: int,
    seconds: float,
    max_bytes: int,
    visibility: NDArray[np.int16] | None = None,
    by_eye: bool = True,
    halvings: int = 0,
) -> bytes:
    """Encode Gaussians, with their integers refined one Gaussian at a time (sgmethod/native/refine/refine.h).

    visibility, by_eye: see squared_error(); halvings: number of times the picture was halved to give the target.
    """

def rd_lay_out(
    parameters: RdParameters, data: bytes, prefix: bool, texture: Texture | None = None
) -> tuple[Rasterization, FloatArray]:
    """Decode a payload to a Rasterization of the whole picture and the colours; the two overlap in time.

    Raises the errors of rd_decode() and Rasterization, with max_pairs_of() as max_pairs.
    """

def rd_decode(
    parameters: RdParameters, data: bytes, prefix: bool = False, max_gaussians: int = ...
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Decode a payload to (means, factors, colors). prefix: data may be cut anywhere.

    Raises RuntimeError on data that no encoder writes, OverflowError for more than max_gaussians.
    """
