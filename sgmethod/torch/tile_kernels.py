"""Triton kernels of tiles.py, which explains them and launches them.

Gaussians are numbered through the whole batch. The record of a Gaussian is x, y, 1 / q1, q2 / q1, 1 / q3 in samples of
its level, and its colour there. The kernels compute the same as pairs.py, in single precision.
"""

from __future__ import annotations

import triton
import triton.language as tl

from sgmethod.backend.protocol import GRID_REACH
from sgmethod.native import native
from sgmethod.torch.pairs import MAX_LEVEL, NARROWEST

TILE = 16
RECORD = 8  # numbers in a record, and sums of a Gaussian over samples
LOW_WORD = (1 << 32) - 1  # the Gaussian in a key

_TILE, _RECORD, _LOW_WORD = tl.constexpr(TILE), tl.constexpr(RECORD), tl.constexpr(LOW_WORD)
_MAX_LEVEL, _NARROWEST_SQUARED = tl.constexpr(MAX_LEVEL), tl.constexpr(NARROWEST**2)
_TINY, _HUGE = tl.constexpr(2.0**-126), tl.constexpr(3.4028234e38)
_MARGIN = tl.constexpr(0.01)  # samples by which an ellipse is widened, more than its rounding error
_ROWS, _COLUMNS = tl.constexpr(8), tl.constexpr(16)  # samples of a Gaussian at a time

_REACH = tl.constexpr(GRID_REACH)
_MAX_SCALE, _MAX_SLANT = tl.constexpr(native.MAX_SCALE), tl.constexpr(native.MAX_SLANT)
_MAX_AMPLITUDE, _FAINT = tl.constexpr(native.MAX_AMPLITUDE), tl.constexpr(native.FAINT)
_COLOR_SCALE, _R_STEP = tl.constexpr(native.COLOR_SCALE), tl.constexpr(native.R_STEP)
_GREY, _WARM, _GREEN = (tl.constexpr(row[0]) for row in native.COLOR_BASIS)  # times (1, 1, 1), (1, 0, -1), (1, -2, 1)
_INVERSE_LN2 = tl.constexpr(1.4426950408889634)


@triton.jit
def _load3(values, at, mask, other):
    return (
        tl.load(values + 3 * at, mask=mask, other=other),
        tl.load(values + 3 * at + 1, mask=mask, other=other),
        tl.load(values + 3 * at + 2, mask=mask, other=other),
    )


@triton.jit
def _store3(values, at, mask, first, second, third):
    tl.store(values + 3 * at, first, mask=mask)
    tl.store(values + 3 * at + 1, second, mask=mask)
    tl.store(values + 3 * at + 2, third, mask=mask)


@triton.jit
def _levelled(x, y, l1, l2, l3, pyramid: tl.constexpr):
    """Level of each Gaussian, -1 for those not drawn; there its factor p, its narrowed factor q, and the blur."""
    a, b = l1 * l1, l3 * l3
    c = l2 * l2 + b
    drawn = (l1 > 0) & (l3 > 0) & (a >= _TINY) & (b >= _TINY) & (a <= _HUGE) & (c <= _HUGE)
    l1, l3 = tl.where(drawn, l1, 1.0), tl.where(drawn, l3, 1.0)
    slant = l2 / (l1 * l3)
    drawn = drawn & (tl.abs(x) <= _HUGE) & (tl.abs(y) <= _HUGE) & (slant * slant <= _HUGE)
    l1, l2, l3 = tl.where(drawn, l1, 1.0), tl.where(drawn, l2, 0.0), tl.where(drawn, l3, 1.0)
    level = tl.zeros_like(l1).to(tl.int32)
    shrink = tl.zeros_like(l1) + 1.0
    if pyramid:
        a, c = l1 * l1, l2 * l2 + l3 * l3
        root = tl.sqrt_rn((a - c) * (a - c) + 4 * (a * l2) * l2)
        minor = tl.div_rn(2 * a * l3 * l3, a + c + root)
        bound = _NARROWEST_SQUARED
        for _ in tl.static_range(_MAX_LEVEL):
            bound = bound * 4
            above = minor >= bound
            level += above.to(tl.int32)
            shrink = tl.where(above, shrink * 0.5, shrink)
    p1, p2, p3 = l1 * shrink, l2 * shrink, l3 * shrink
    blur = tl.sqrt_rn(1 - shrink * shrink) / 2
    ratio1 = tl.sqrt_rn(1 - (blur / p1) * (blur / p1))
    q1 = p1 * ratio1
    slanted = blur / p3 * (p2 / q1)
    ratio3 = tl.sqrt_rn(1 - (blur / p3) * (blur / p3) - slanted * slanted)
    return tl.where(drawn, level, -1), shrink, p1, p2, p3, q1, p2 / ratio1, p3 * ratio3, blur


@triton.jit
def _rows(y, q2, q3, reach, border, height):
    """First and last row of an ellipse; none if last < first."""
    half = reach * tl.sqrt(q2 * q2 + q3 * q3) + _MARGIN
    low, high = -border.to(tl.float32), (height + border).to(tl.float32)
    first = tl.minimum(tl.maximum(tl.ceil(y - half - 0.5), low), high)
    last = tl.minimum(tl.maximum(tl.floor(y + half - 0.5), low - 1), high - 1)
    return first.to(tl.int32), last.to(tl.int32)


@triton.jit
def _columns(top, bottom, x, y, q1, q2, q3, reach, border, width):
    """First and last column in which an ellipse meets the rows top to bottom; none if last < first.

    At z = dy / spread it reaches from q1 (sine z - cosine r) to q1 (sine z + cosine r) with r^2 = reach^2 - z^2. That
    is farthest left at z = -reach sine, farthest right at z = reach sine.
    """
    spread = tl.sqrt(q2 * q2 + q3 * q3)
    sine, cosine = q2 / spread, q3 / spread
    above = tl.minimum(tl.maximum((top + 0.5 - y) / spread, -reach), reach)
    below = tl.minimum(tl.maximum((bottom + 0.5 - y) / spread, -reach), reach)
    z = tl.minimum(tl.maximum(-reach * sine, above), below)
    left = q1 * (sine * z - cosine * tl.sqrt(tl.maximum(reach * reach - z * z, 0.0))) - _MARGIN
    z = tl.minimum(tl.maximum(reach * sine, above), below)
    right = q1 * (sine * z + cosine * tl.sqrt(tl.maximum(reach * reach - z * z, 0.0))) + _MARGIN
    low, high = -border.to(tl.float32), (width + border).to(tl.float32)
    first = tl.minimum(tl.maximum(tl.ceil(x + left - 0.5), low), high)
    last = tl.minimum(tl.maximum(tl.floor(x + right - 0.5), low - 1), high - 1)
    return first.to(tl.int32), last.to(tl.int32)


@triton.jit(do_not_specialize=["total", "each", "tiles", "capacity"])
def assign(means, factors, colors, table, levels, records, counts, ends, keys,
          total, each, tiles, capacity, reach, scale, pyramid: tl.constexpr, lists: tl.constexpr,
          block: tl.constexpr):  # fmt: skip
    """Find each Gaussian's level, record and number of tiles; or, if `lists`, write its pairs of tile and Gaussian.

    table: of each level the first sample, width, height, first tile and tiles in a row. Pairs are written up to
    `ends`, the running sum of the counts, unless that exceeds the capacity.
    """
    g = tl.program_id(0) * block + tl.arange(0, block)
    here = g < total
    x = tl.load(means + 2 * g, mask=here, other=0.0) * scale
    y = tl.load(means + 2 * g + 1, mask=here, other=0.0) * scale
    l1, l2, l3 = _load3(factors, g, here, 0.0)
    level, shrink, p1, _, p3, q1, q2, q3, _ = _levelled(x, y, l1 * scale, l2 * scale, l3 * scale, pyramid)
    drawn = level >= 0
    x, y = tl.where(drawn, x, 0.0) * shrink, tl.where(drawn, y, 0.0) * shrink
    if not lists:
        c1, c2, c3 = _load3(colors, g, here, 0.0)
        gain = p1 / q1 * (p3 / q3)
        tl.store(levels + g, level, mask=here)
        at = records + _RECORD * g.to(tl.int64)
        tl.store(at, x, mask=here)
        tl.store(at + 1, y, mask=here)
        tl.store(at + 2, 1 / q1, mask=here)
        tl.store(at + 3, q2 / q1, mask=here)
        tl.store(at + 4, 1 / q3, mask=here)
        tl.store(at + 5, tl.where(drawn, c1 * gain, 0.0), mask=here)
        tl.store(at + 6, tl.where(drawn, c2 * gain, 0.0), mask=here)
        tl.store(at + 7, tl.where(drawn, c3 * gain, 0.0), mask=here)
    own = table + 5 * tl.maximum(level, 0)
    width, height = tl.load(own + 1), tl.load(own + 2)
    border = tl.minimum(tl.maximum(level, 0), 1)
    first_row, last_row = _rows(y, q2, q3, reach, border, height)
    last_row = tl.where(drawn & here, last_row, first_row - 1)
    first, last = (first_row + border) // _TILE, (last_row + border + _TILE) // _TILE - 1
    count = tl.zeros_like(level)
    if lists:
        end = tl.load(ends + g, mask=here, other=0)
        fits = here & (end <= capacity)
        to = keys + end - tl.load(counts + g, mask=here, other=0)
        tile_row = (g // each) * tiles + tl.load(own + 3)
        across = tl.load(own + 4)
    for row in range(0, tl.max(last - first, axis=0) + 1):
        top = (first + row) * _TILE - border
        left, right = _columns(tl.maximum(top, first_row), tl.minimum(top + _TILE - 1, last_row),
                               x, y, q1, q2, q3, reach, border, width)  # fmt: skip
        left, right = (left + border) // _TILE, (right + border + _TILE) // _TILE - 1
        found = tl.where(first + row <= last, tl.maximum(right - left + 1, 0), 0)
        if lists:
            tile = (tile_row + (first + row) * across + left).to(tl.int64)
            for k in range(0, tl.max(found, axis=0)):
                tl.store(to + count + k, ((tile + k) << 32) | g, mask=fits & (k < found))
        count += found
    if not lists:
        tl.store(counts + g, count, mask=here)


@triton.jit(do_not_specialize=["each", "pictures", "capacity"])
def walk(planes, table, levels, records, ends, sums, each, pictures, capacity, reach, floor, draws: tl.constexpr):
    """Visit the samples of one Gaussian, a block at a time along its ellipse.

    Sum up the gradient times weight (3), z (2) and z z^T (3); or, if `draws`, add the Gaussian to the planes where the
    lists have no room for it.
    """
    g = tl.program_id(0).to(tl.int64)
    level = tl.load(levels + g)
    is_drawn = level >= 0
    if draws:
        is_drawn = is_drawn & (tl.load(ends + g) > capacity)
    at = records + _RECORD * g
    x, y, i1, shear, i3 = tl.load(at), tl.load(at + 1), tl.load(at + 2), tl.load(at + 3), tl.load(at + 4)
    c1, c2, c3 = tl.load(at + 5), tl.load(at + 6), tl.load(at + 7)
    level = tl.maximum(level, 0)
    own = table + 5 * level
    width, height = tl.load(own + 1), tl.load(own + 2)
    border = tl.minimum(level, 1)
    stride = width + 2 * border
    area = stride * (height + 2 * border)
    origin = planes + 3 * (tl.load(own).to(tl.int64) * pictures + g // each * area)
    q1, q3 = 1 / i1, 1 / i3
    q2 = shear * q1
    first_row, last_row = _rows(y, q2, q3, reach, border, height)
    last_row = tl.where(is_drawn, last_row, first_row - 1)
    zero = tl.zeros([_ROWS, _COLUMNS], tl.float32)
    by_c1, by_c2, by_c3, a1, a2, b11, b12, b22 = zero, zero, zero, zero, zero, zero, zero, zero
    for top in range(first_row, last_row + 1, _ROWS):
        bottom = tl.minimum(top + _ROWS - 1, last_row)
        first, last = _columns(top, bottom, x, y, q1, q2, q3, reach, border, width)
        row = top + tl.arange(0, _ROWS)[:, None]
        dy = row.to(tl.float32) + 0.5 - y
        for left in range(first, last + 1, _COLUMNS):
            column = left + tl.arange(0, _COLUMNS)[None, :]
            here = (row <= last_row) & (column <= last)
            dx = column.to(tl.float32) + 0.5 - x
            z1, z2 = dx * i1 + zero, (dy - shear * dx) * i3
            e = tl.exp(-(z1 * z1 + z2 * z2) / 2)
            weight = tl.where(here, tl.maximum(e - floor, 0.0), 0.0)
            to = origin + (row + border) * stride + (column + border)
            if draws:
                tl.atomic_add(to, c1 * weight, mask=here)
                tl.atomic_add(to + area, c2 * weight, mask=here)
                tl.atomic_add(to + 2 * area, c3 * weight, mask=here)
            else:
                s1 = tl.load(to, mask=here, other=0.0)
                s2 = tl.load(to + area, mask=here, other=0.0)
                s3 = tl.load(to + 2 * area, mask=here, other=0.0)
                by_c1, by_c2, by_c3 = by_c1 + s1 * weight, by_c2 + s2 * weight, by_c3 + s3 * weight
                by_weight = tl.where(weight > 0, (c1 * s1 + c2 * s2 + c3 * s3) * e, 0.0)
                z1, z2 = tl.where(weight > 0, z1, 0.0), tl.where(weight > 0, z2, 0.0)
                by_z1, by_z2 = by_weight * z1, by_weight * z2
                a1, a2 = a1 + by_z1, a2 + by_z2
                b11, b12, b22 = b11 + by_z1 * z1, b12 + by_z1 * z2, b22 + by_z2 * z2
    if not draws:
        to = sums + _RECORD * g
        tl.store(to, tl.sum(by_c1))
        tl.store(to + 1, tl.sum(by_c2))
        tl.store(to + 2, tl.sum(by_c3))
        tl.store(to + 3, tl.sum(a1))
        tl.store(to + 4, tl.sum(a2))
        tl.store(to + 5, tl.sum(b11))
        tl.store(to + 6, tl.sum(b12))
        tl.store(to + 7, tl.sum(b22))


@triton.jit
def _finished(value, plane, coarse, target, row, column, here, at, stride, scale,
              enlarges: tl.constexpr, compares: tl.constexpr):  # fmt: skip
    """Complete one channel of a tile and store it.

    The plane's own value and the next level, enlarged, are added to the sum of the listed Gaussians. If `compares`, the
    gradient of the error is stored in place of the picture.
    """
    value += tl.load(plane + at, mask=here, other=0.0)
    if enlarges:
        near = coarse + ((row >> 1) + 1) * stride + (column >> 1) + 1
        across, down = tl.where(column & 1 == 1, 1, -1), tl.where(row & 1 == 1, stride, -stride)
        value += 0.5625 * tl.load(near, mask=here, other=0.0)
        value += 0.0625 * tl.load(near + across + down, mask=here, other=0.0)
        value += 0.1875 * tl.load(near + across, mask=here, other=0.0)
        value += 0.1875 * tl.load(near + down, mask=here, other=0.0)
    if compares:
        value = (value - tl.load(target + at, mask=here, other=0.0)) * scale
    tl.store(plane + at, value, mask=here)


@triton.jit(
    do_not_specialize=["tiles", "start", "across", "width", "height", "border", "stride", "area", "coarse_area"]
)
def draw(planes, coarse, target, records, keys, starts, tiles, start, across, width, height, border,
         stride, area, coarse_area, floor, scale, enlarges: tl.constexpr, compares: tl.constexpr):  # fmt: skip
    """Draw one tile of a level: its listed Gaussians, on top of the next level, whose rows are `stride` long.

    width, height, area: with borders; start: the level's first tile among a picture's.
    """
    tile, picture = tl.program_id(0), tl.program_id(1).to(tl.int64)
    row = (tile // across) * _TILE + tl.arange(0, _TILE)[:, None]
    column = (tile % across) * _TILE + tl.arange(0, _TILE)[None, :]
    here, at = (row < height) & (column < width), row * width + column
    row, column = row - border, column - border
    red = tl.zeros([_TILE, _TILE], tl.float32)
    green, blue = red, red
    listed = starts + picture * tiles + start + tile
    for i in range(tl.load(listed).to(tl.int32), tl.load(listed + 1).to(tl.int32)):
        one = records + _RECORD * (tl.load(keys + i) & _LOW_WORD)
        dx = column.to(tl.float32) + 0.5 - tl.load(one)
        dy = row.to(tl.float32) + 0.5 - tl.load(one + 1)
        z1, z2 = dx * tl.load(one + 2), (dy - tl.load(one + 3) * dx) * tl.load(one + 4)
        weight = tl.maximum(tl.exp(-(z1 * z1 + z2 * z2) / 2) - floor, 0.0)
        red += tl.load(one + 5) * weight
        green += tl.load(one + 6) * weight
        blue += tl.load(one + 7) * weight
    planes += 3 * picture * area
    target += 3 * picture * area
    coarse += 3 * picture * coarse_area
    _finished(red, planes, coarse, target, row, column, here, at, stride, scale, enlarges, compares)
    _finished(green, planes + area, coarse + coarse_area, target + area, row, column, here, at, stride, scale,
              enlarges, compares)  # fmt: skip
    _finished(blue, planes + 2 * area, coarse + 2 * coarse_area, target + 2 * area, row, column, here, at, stride,
              scale, enlarges, compares)  # fmt: skip


@triton.jit(do_not_specialize=["across", "width", "height", "border", "coarse_width", "coarse_height"])
def reduce(fine, coarse, across, width, height, border, coarse_width, coarse_height):
    """Take the gradient by a level's samples to the next level: the transpose of enlarging. Sizes: with borders."""
    tile, picture = tl.program_id(0), tl.program_id(1).to(tl.int64)
    row = (tile // across) * _TILE + tl.arange(0, _TILE)[:, None]
    column = (tile % across) * _TILE + tl.arange(0, _TILE)[None, :]
    here = (row < coarse_height) & (column < coarse_width)
    for channel in range(3):
        plane = fine + (3 * picture + channel) * (width * height)
        total = tl.zeros([_TILE, _TILE], tl.float32)
        for i in tl.static_range(4):
            y = 2 * (row - 1) - 1 + i + border
            for j in tl.static_range(4):
                x = 2 * (column - 1) - 1 + j + border
                inside = here & (y >= 0) & (y < height) & (x >= 0) & (x < width)
                share = (0.25 if i % 3 == 0 else 0.75) * (0.25 if j % 3 == 0 else 0.75)
                total += share * tl.load(plane + y * width + x, mask=inside, other=0.0)
        to = coarse + (3 * picture + channel) * (coarse_width * coarse_height)
        tl.store(to + row * coarse_width + column, total, mask=here)


@triton.jit
def _chained(means, factors, colors, sums, g, here, scale, pyramid: tl.constexpr):
    """Gradients by means, factors and colours, from a Gaussian's sums (Pairs._by_parameters)."""
    x = tl.load(means + 2 * g, mask=here, other=0.0) * scale
    y = tl.load(means + 2 * g + 1, mask=here, other=0.0) * scale
    l1, l2, l3 = _load3(factors, g, here, 1.0)
    level, shrink, p1, p2, p3, q1, q2, q3, blur = _levelled(x, y, l1 * scale, l2 * scale, l3 * scale, pyramid)
    here = here & (level >= 0)
    color1, color2, color3 = _load3(colors, g, here, 0.0)
    at = sums + _RECORD * g.to(tl.int64)
    c1, c2 = tl.load(at, mask=here, other=0.0), tl.load(at + 1, mask=here, other=0.0)
    c3, a1 = tl.load(at + 2, mask=here, other=0.0), tl.load(at + 3, mask=here, other=0.0)
    a2, b11 = tl.load(at + 4, mask=here, other=0.0), tl.load(at + 5, mask=here, other=0.0)
    b12, b22 = tl.load(at + 6, mask=here, other=0.0), tl.load(at + 7, mask=here, other=0.0)
    gain = p1 / q1 * (p3 / q3)
    c1, c2, c3 = c1 * gain, c2 * gain, c3 * gain
    by_log_gain = color1 * c1 + color2 * c2 + color3 * c3
    by_q1, by_q2, by_q3 = b11 / q1 - q2 / q1 * (b12 / q3), b12 / q3, b22 / q3 - by_log_gain / q3
    slope, v = p2 / q1, (blur / q1) * (blur / q1)
    slant = by_q3 * (blur / q1) * (blur / q3) * slope
    by_l1 = (by_q1 + slant * slope) * (p1 / q1) - (by_q2 * slope + by_log_gain / p1) * v
    ratio = p3 / q3  # 1 on the finest level: the gain, which can be much larger than b22, then leaves no rounding error
    by_l2, by_l3 = by_q2 * (p1 / q1) - slant, b22 / q3 * ratio + by_log_gain / p3 * (1 - ratio * ratio)
    by_x, by_y, shrink = a1 / q1 - q2 / q1 * (a2 / q3), a2 / q3, shrink * scale
    return by_x * shrink, by_y * shrink, by_l1 * shrink, by_l2 * shrink, by_l3 * shrink, c1, c2, c3


@triton.jit(do_not_specialize=["total"])
def gradients(means, factors, colors, sums, by_means, by_factors, by_colors, total, scale, pyramid: tl.constexpr,
              block: tl.constexpr):  # fmt: skip
    """Turn sums into gradients."""
    g = tl.program_id(0) * block + tl.arange(0, block)
    here = g < total
    by_x, by_y, by_l1, by_l2, by_l3, c1, c2, c3 = _chained(means, factors, colors, sums, g, here, scale, pyramid)
    tl.store(by_means + 2 * g, by_x, mask=here)
    tl.store(by_means + 2 * g + 1, by_y, mask=here)
    _store3(by_factors, g, here, by_l1, by_l2, by_l3)
    _store3(by_colors, g, here, c1, c2, c3)


@triton.jit
def _sign(value):
    return tl.where(value > 0, 1.0, tl.where(value < 0, -1.0, 0.0))


@triton.jit
def _of_bits(l1, l2, l3, c1, c2, c3, quantum, weight):
    """Gradients of `weight` times the bits by factor and colour (native/rd/steps.cpp)."""
    inverse, weight = _COLOR_SCALE * tl.sqrt(l1 * l3) / quantum, weight * _INVERSE_LN2
    grey, warm = (c1 + c2 + c3) * (_GREY * inverse), (c1 - c3) * (_WARM * inverse)
    green = (c1 - 2 * c2 + c3) * (_GREEN * inverse)
    m = tl.sqrt(grey * grey + warm * warm + green * green + 1e-12)
    v, r = 0.5 * tl.log(l1 / l3), l2 / l3
    by_v, by_r = weight / (1 + tl.abs(v) * m), weight / (_R_STEP + tl.abs(r) * m)
    by_m = by_v * tl.abs(v) + by_r * tl.abs(r) + 3 * weight / (1 + m)
    by_grey = _sign(grey) * weight / (1 + tl.abs(grey)) + by_m * grey / m
    by_warm = _sign(warm) * weight / (1 + tl.abs(warm)) + by_m * warm / m
    by_green = _sign(green) * weight / (1 + tl.abs(green)) + by_m * green / m
    by_size = by_grey * grey + by_warm * warm + by_green * green
    by_v, by_r = _sign(v) * by_v * m, _sign(r) * by_r * m
    by_grey, by_warm, by_green = by_grey * _GREY * inverse, by_warm * _WARM * inverse, by_green * _GREEN * inverse
    return (0.5 * (by_size + by_v) / l1, by_r / l3, (0.5 * (by_size - by_v) - by_r * r) / l3,
            by_grey + by_warm + by_green, by_grey - 2 * by_green, by_grey - by_warm + by_green)  # fmt: skip


@triton.jit
def _move(first, second, gradient, here, rate, limit, beta1, beta2, bias1, bias2):
    """Update the moments of one value, and return how far it moves."""
    m1 = beta1 * tl.load(first, mask=here, other=0.0) + (1 - beta1) * gradient
    m2 = beta2 * tl.load(second, mask=here, other=0.0) + (1 - beta2) * gradient * gradient
    tl.store(first, m1, mask=here)
    tl.store(second, m2, mask=here)
    return -tl.minimum(rate / (tl.sqrt(m2 / (1 - bias2)) + 1e-15), limit) * m1 / (1 - bias1)


@triton.jit(do_not_specialize=["total", "each"])
def step(means, factors, colors, sums, first, second, bias, quanta, prices, total, each, scale,
         mean_rate, factor_rate, color_rate, beta1, beta2, least, newton, width, height, pyramid: tl.constexpr,
         block: tl.constexpr):  # fmt: skip
    """Add the price of bits to the gradients, take one step of Adam, and keep the values in range (Backend)."""
    g = tl.program_id(0) * block + tl.arange(0, block)
    here = g < total
    by_x, by_y, by_l1, by_l2, by_l3, by_c1, by_c2, by_c3 = _chained(
        means, factors, colors, sums, g, here, scale, pyramid
    )
    l1, l2, l3 = _load3(factors, g, here, 1.0)
    here = here & (l1 > 0) & (l3 > 0)  # others only fill up a picture
    l1, l3 = tl.where(here, l1, 1.0), tl.where(here, l3, 1.0)
    c1, c2, c3 = _load3(colors, g, here, 0.0)
    quantum = tl.load(quanta + g // each, mask=here, other=1.0)
    price = tl.load(prices + g // each, mask=here, other=0.0)
    r1, r2, r3, r4, r5, r6 = _of_bits(l1, l2, l3, c1, c2, c3, quantum, price)
    by_l1, by_l2, by_l3, by_c1, by_c2, by_c3 = by_l1 + r1, by_l2 + r2, by_l3 + r3, by_c1 + r4, by_c2 + r5, by_c3 + r6
    bias1 = beta1 * tl.load(bias + 2 * g, mask=here, other=0.0)
    bias2 = beta2 * tl.load(bias + 2 * g + 1, mask=here, other=0.0)
    tl.store(bias + 2 * g, bias1, mask=here)
    tl.store(bias + 2 * g + 1, bias2, mask=here)
    of_color = newton / (l1 * l3)
    of_shape = of_color / tl.maximum(c1 * c1 + c2 * c2 + c3 * c3, _FAINT)
    m, s = first + _RECORD * g.to(tl.int64), second + _RECORD * g.to(tl.int64)
    d1 = _move(m, s, l1 * by_x + l2 * by_y, here, mean_rate, 2 * of_shape, beta1, beta2, bias1, bias2)
    d2 = _move(m + 1, s + 1, l3 * by_y, here, mean_rate, 2 * of_shape, beta1, beta2, bias1, bias2)
    s1 = _move(m + 2, s + 2, l1 * by_l1 + l2 * by_l2, here, factor_rate, of_shape * (4 / 3), beta1, beta2, bias1, bias2)
    s2 = _move(m + 3, s + 3, l3 * by_l2, here, factor_rate, 4 * of_shape, beta1, beta2, bias1, bias2)
    s3 = _move(m + 4, s + 4, l3 * by_l3, here, factor_rate, of_shape * (4 / 3), beta1, beta2, bias1, bias2)
    c1 += _move(m + 5, s + 5, by_c1, here, color_rate, of_color, beta1, beta2, bias1, bias2)
    c2 += _move(m + 6, s + 6, by_c2, here, color_rate, of_color, beta1, beta2, bias1, bias2)
    c3 += _move(m + 7, s + 7, by_c3, here, color_rate, of_color, beta1, beta2, bias1, bias2)
    x = tl.load(means + 2 * g, mask=here, other=0.0) + l1 * d1
    y = tl.load(means + 2 * g + 1, mask=here, other=0.0) + l2 * d1 + l3 * d2
    l2 = l2 * tl.exp(s1) + l3 * s2
    l1 = tl.minimum(tl.maximum(l1 * tl.exp(s1), least), _MAX_SCALE)
    l3 = tl.minimum(tl.maximum(l3 * tl.exp(s3), least), _MAX_SCALE)
    l2 = tl.minimum(tl.maximum(l2, l3 * -_MAX_SLANT), l3 * _MAX_SLANT)
    margin = tl.sqrt(l1 * l3) * _REACH
    x = tl.minimum(tl.maximum(x, -margin), width + margin)
    y = tl.minimum(tl.maximum(y, -margin), height + margin)
    tl.store(means + 2 * g, x, mask=here)
    tl.store(means + 2 * g + 1, y, mask=here)
    _store3(factors, g, here, l1, l2, l3)
    c1 = tl.minimum(tl.maximum(c1, -_MAX_AMPLITUDE), _MAX_AMPLITUDE)
    c2 = tl.minimum(tl.maximum(c2, -_MAX_AMPLITUDE), _MAX_AMPLITUDE)
    c3 = tl.minimum(tl.maximum(c3, -_MAX_AMPLITUDE), _MAX_AMPLITUDE)
    _store3(colors, g, here, c1, c2, c3)
