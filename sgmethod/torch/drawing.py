"""The differentiable renderer, as two operators of torch: drawing, and its gradients.

Single precision goes to the compiled kernels on the CPU, and to Triton's (tiles.py) on a GPU that has them;
everything else goes to lists of pairs (pairs.py), which are plain operations on tensors. All draw what
docs/format.md defines.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor
from torch.autograd import forward_ad

from sgmethod.arguments import AnyFloat, AnyInt, checked_integer, finite_number
from sgmethod.backend.protocol import Frame
from sgmethod.errors import GaussiansError, ViewError
from sgmethod.native import native
from sgmethod.torch.devices import has_tiles
from sgmethod.torch.pairs import Pairs, is_drawn
from sgmethod.view import MAX_SCALE, MIN_SCALE, PIXEL_VARIANCE, variance

if TYPE_CHECKING:
    from sgmethod.torch.tiles import Tiles


def render(
    means: Tensor,
    factors: Tensor,
    colors: Tensor,
    size: Iterable[AnyInt],
    background: npt.ArrayLike | Tensor = 0.0,
    scale: AnyFloat = 1.0,
    pyramid: bool = False,
) -> Tensor:
    """Draw Gaussians as a picture [..., 3, height, width], differentiable in all tensors: 0 black, 1 white, unclamped.

    >>> means, factors = torch.tensor([[4.0, 3.0]]), torch.tensor([[2.0, 0.0, 1.0]])
    >>> render(means, factors, torch.ones(1, 3), (8, 6)).shape
    torch.Size([3, 6, 8])

    means [..., N, 2]: centres (x, y) in pixels, the first pixel's centre at (0.5, 0.5);
    factors [..., N, 3]: (l1, l2, l3) in pixels of the lower triangular L, covariance = L L^T;
    colors [..., N, 3]: red, green and blue, of any sign. All of one device, in float32 or float64; autocast to float32.
    size: width and height of the picture in pixels.
    background: below the Gaussians, a number or [..., 3].
    scale: output pixels per pixel of the picture, 1/64 to 64.
    pyramid: draw as files are drawn, with wide Gaussians on coarser levels; else the picture is the sum of the
    Gaussians, each evaluated at every pixel that it covers. One wide Gaussian of colour 1 differs by up to 0.02, a
    fitted photograph by 0.002 (root mean square).

    Gaussians with a value that is not finite, with l1 or l3 <= 0, or with a covariance or an inverse of it that the
    precision cannot hold, are not drawn, and get gradients of 0. On the CPU, a RuntimeWarning warns of values that are
    not finite, unless compiled. Raises GaussiansError for other shapes, and ViewError for an invalid scale or size.
    """
    means, factors, colors, lead = _checked(means, factors, colors)
    _warn_unless_finite(means, factors, colors)
    width, height = checked_size(size)
    number = finite_number(scale)
    if number is None or not MIN_SCALE <= number <= MAX_SCALE:
        raise ViewError(f"the scale must lie in {MIN_SCALE} .. {MAX_SCALE:g}, got {scale!r}")
    resized = max(round(width * number), 1), max(round(height * number), 1)
    means, factors, colors = _resized(means, factors, colors, (resized[0] / width, resized[1] / height))
    image = _drawn(means, factors, colors, resized, pyramid).reshape(*lead, 3, *resized[::-1])
    below = torch.as_tensor(background, dtype=means.dtype, device=means.device)
    return image + (below[..., None, None] if below.ndim else below)


def checked_size(size: object) -> tuple[int, int]:
    """Return a width and a height as integers. Raises ViewError for anything else."""
    sides = list(size) if isinstance(size, Iterable) else []
    if len(sides) != 2:
        raise ViewError(f"a size is width and height in pixels, not {size!r}")
    width, height = (checked_integer(side, "a side", 1, native.MAX_SIDE, ViewError) for side in sides)
    return width, height


def _checked(means: Tensor, factors: Tensor, colors: Tensor) -> tuple[Tensor, Tensor, Tensor, tuple[int, ...]]:
    """Reshape tensors to [B, N, ...]; also return the leading dimensions."""
    tensors = means, factors, colors = [_autocast(values) for values in (means, factors, colors)]
    for values, name, last in zip(tensors, ("means", "factors", "colors"), (2, 3, 3), strict=True):
        if not isinstance(values, Tensor) or values.ndim < 2 or values.shape[-1] != last:
            found = list(values.shape) if isinstance(values, Tensor) else type(values).__name__
            raise GaussiansError(f"{name} must be a tensor [..., N, {last}], not {found}")
        if values.dtype not in (torch.float32, torch.float64) or values.dtype != means.dtype:
            raise GaussiansError(
                f"means, factors and colors must all be float32 or all float64; {name} are {values.dtype}"
            )
        if values.device != means.device or values.shape[-2] != means.shape[-2]:
            raise GaussiansError("means, factors and colors must be of one device, and of as many Gaussians")
    try:
        lead = torch.broadcast_shapes(*(values.shape[:-2] for values in tensors))  # type: ignore[no-untyped-call]
    except RuntimeError as error:
        raise GaussiansError("the leading dimensions of means, factors and colors differ") from error
    n = means.shape[-2]
    own = (values.expand(*lead, n, -1).reshape(math.prod(lead), n, values.shape[-1]) for values in tensors)
    return *own, tuple(lead)  # type: ignore[return-value]


def _autocast(values: Tensor) -> Tensor:
    """Return a tensor in the precision in which it is drawn, where torch chooses precisions."""
    if not isinstance(values, Tensor) or values.dtype not in (torch.bfloat16, torch.float16):
        return values
    device = values.device.type
    return values.float() if torch.amp.is_autocast_available(device) and torch.is_autocast_enabled(device) else values


def _warn_unless_finite(*tensors: Tensor) -> None:
    """Warn of values that are not finite, which no picture shows, where nothing has to wait for a GPU."""
    if torch.compiler.is_compiling() or forward_ad._current_level >= 0 or tensors[0].device.type != "cpu":
        return
    if not all(values.isfinite().all() for values in tensors):
        message = "Gaussians with values that are not finite are not drawn; if this is a fit, it has diverged"
        warnings.warn(message, RuntimeWarning, stacklevel=3)


def _resized(
    means: Tensor, factors: Tensor, colors: Tensor, scale: tuple[float, float]
) -> tuple[Tensor, Tensor, Tensor]:
    """Scale Gaussians to output pixels, low-passed as sgmethod/view.py does it.

    Those that are not drawn become valid ones of colour 0, since their own values would turn gradients into NaN.
    """
    sx, sy = scale
    if scale != (1, 1):
        (x, y), (l1, l2, l3) = means.unbind(-1), factors.unbind(-1)
        means, factors = torch.stack([x * sx, y * sy], -1), torch.stack([l1 * sx, l2 * sy, l3 * sy], -1)
    drawn = (is_drawn(means, factors) & colors.isfinite().all(-1))[..., None]
    means = torch.where(drawn, means, -9)  # beyond the edge
    factors, colors = torch.where(drawn, factors, 1), torch.where(drawn, colors, 0)
    if min(scale) >= 1:
        return means, factors, colors
    widening = PIXEL_VARIANCE / variance(native.CUTOFF_V2)
    wide_x, wide_y = (max(1 - s * s, 0.0) * widening for s in scale)
    l1, l2, l3 = factors.unbind(-1)
    n1 = (l1 * l1 + wide_x).sqrt()
    slant = l2 / n1
    n2, n3 = l1 * slant, (l3 * l3 + wide_y + slant * slant * wide_x).sqrt()
    return means, torch.stack([n1, n2, n3], -1), colors * (l1 / n1 * (l3 / n3))[..., None]


def _drawn(means: Tensor, factors: Tensor, colors: Tensor, size: tuple[int, int], pyramid: bool) -> Tensor:
    """Draw Gaussians [B, N, ...] as pictures [B, 3, height, width].

    In forward mode, torch silently drops tangents of custom operators, so there it differentiates the list of pairs.
    """
    if forward_ad._current_level < 0:  # not in forward mode; torch has no public name for this
        image: Tensor = _draw(means, factors, colors, *size, pyramid)
        return image
    rows = zip(means, factors, colors, strict=True)
    images = [Pairs(mean, factor, size, native.CUTOFF_V2, pyramid).draw(color) for mean, factor, color in rows]
    return torch.stack(images) if images else colors.new_empty(0, 3, *size[::-1])


@torch.library.custom_op("sgmethod::draw", mutates_args=())
def _draw(means: Tensor, factors: Tensor, colors: Tensor, width: int, height: int, pyramid: bool) -> Tensor:
    """Draw Gaussians [B, N, ...] as pictures [B, 3, height, width]."""
    if _is_tiled(colors):
        return _tiles(means, factors, colors, width, height, pyramid).draw()
    image = colors.new_empty(len(colors), 3, height, width)
    for mean, factor, color, to in zip(means, factors, colors, image, strict=True):
        if _has_kernels(color):
            raster = _kernels(mean, factor, width, height, pyramid)
            raster.render(_numpy(color), to.numpy())
        else:
            to[:] = Pairs(mean, factor, (width, height), native.CUTOFF_V2, pyramid).draw(color)
    return image


@torch.library.custom_op("sgmethod::draw_backward", mutates_args=())
def _draw_backward(
    means: Tensor, factors: Tensor, colors: Tensor, by_image: Tensor, pyramid: bool
) -> tuple[Tensor, Tensor, Tensor]:
    """Return gradients by means, factors and colours, given the gradient by the picture [B, 3, height, width]."""
    height, width = by_image.shape[2:]
    if _is_tiled(colors):
        return _tiles(means, factors, colors, width, height, pyramid).gradients(by_image)
    out = _gradients_of(means, factors, colors)
    for mean, factor, color, by, *to in zip(means, factors, colors, by_image, *out, strict=True):
        if _has_kernels(color):
            raster = _kernels(mean, factor, width, height, pyramid)
            raster.backward(_numpy(color), _numpy(by), *(values.numpy() for values in to))
        else:
            found = Pairs(mean, factor, (width, height), native.CUTOFF_V2, pyramid).gradients(color, by)
            for values, gradient in zip(to, found, strict=True):
                values[:] = gradient
    return out


def _gradients_of(means: Tensor, factors: Tensor, colors: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Allocate gradients, contiguous whatever the layout of the parameters."""
    return means.new_empty(means.shape), factors.new_empty(factors.shape), colors.new_empty(colors.shape)


def _has_kernels(values: Tensor) -> bool:
    return values.device.type == "cpu" and values.dtype == torch.float32


def _is_tiled(values: Tensor) -> bool:
    return values.dtype == torch.float32 and not _has_kernels(values) and has_tiles(values.device)


def _tiles(means: Tensor, factors: Tensor, colors: Tensor, width: int, height: int, pyramid: bool) -> Tiles:
    from sgmethod.torch.tiles import Tiles

    return Tiles(Frame(width, height, native.CUTOFF_V2, pyramid), means, factors, colors)


def _numpy(values: Tensor) -> np.ndarray:
    return values.contiguous().numpy()


def _kernels(means: Tensor, factors: Tensor, width: int, height: int, pyramid: bool) -> native.Rasterization:
    return native.Rasterization(_numpy(means), _numpy(factors), width, height, native.CUTOFF_V2, pyramid=pyramid)


@_draw.register_fake
def _(_means: Tensor, _factors: Tensor, colors: Tensor, width: int, height: int, _pyramid: bool) -> Tensor:
    return colors.new_empty(len(colors), 3, height, width)


@_draw_backward.register_fake
def _(
    means: Tensor, factors: Tensor, colors: Tensor, _by_image: Tensor, _pyramid: bool
) -> tuple[Tensor, Tensor, Tensor]:
    return _gradients_of(means, factors, colors)


def _save(ctx: Any, inputs: tuple[Any, ...], output: Tensor) -> None:  # noqa: ARG001 - torch calls it by these names
    *tensors, _width, _height, ctx.pyramid = inputs
    ctx.save_for_backward(*tensors)


def _differentiate(ctx: Any, by_image: Tensor) -> tuple[Tensor | None, ...]:
    return *_draw_backward(*ctx.saved_tensors, by_image, ctx.pyramid), None, None, None


_draw.register_autograd(_differentiate, setup_context=_save)
