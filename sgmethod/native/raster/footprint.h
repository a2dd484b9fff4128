// One Gaussian over a grid of samples: its data for the kernels, and the rows and lanes it covers in each strip of
// columns.
//
// The edge of its ellipse at dx is shear dx + l3 sqrt(reach^2 - (dx / l1)^2), which is concave, with its summit at dx =
// reach l1 l2 / sqrt(l2^2 + l3^2). The lanes of a vector are neighbouring strips of one Gaussian.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>

#include "core/constants.h"
#include "core/simd.h"

namespace sg {

// A part of a picture's samples, or of a coarser level's (levels.h). It begins at a tile, so that a tile's values do
// not depend on the part drawn.
struct Grid {
  int x = 0, y = 0;  // of the first sample; multiples of kTileWidth and kTileHeight
  int width = 0, height = 0;
  int strips() const { return (width + kTileWidth - 1) / kTileWidth; }
  int blocks() const { return (height + kTileHeight - 1) / kTileHeight; }
  int tiles() const { return strips() * blocks(); }
};

// Rows covered in one strip of columns, and the range of their lanes; all inclusive.
struct Span {
  int strip, first_row, last_row;
  uint8_t first_lane, last_lane;
};

// One Gaussian prepared for the kernels. z1 = dx / l1, z2 = (dy - shear dx) / l3, sigma = (z1^2 + z2^2) / 2.
struct Footprint {
  Footprint() = default;
  // Sets all but decay and gain. segment is 0, for nothing to draw, if values are not finite or l1 or l3 not positive.
  // Without branches, so that the compiler vectorises loops over many.
  SG_INLINE Footprint(const float* mean, const float* factor)
      : x(mean[0]), y(mean[1]), inv_l1(1.0f / factor[0]), inv_l3(1.0f / factor[2]), shear(factor[1] / factor[0]),
        segment(drawable(factor[0], factor[1], factor[2]) ? segment_rows(factor[2]) : 0) {}

  float x, y;  // mean, pixels; pixel (row, column) has its centre at (column + 0.5, row + 0.5)
  float inv_l1, inv_l3;  // 1 / l1, 1 / l3
  float shear;  // l2 / l1
  float decay = 0.0f;  // exp(-1 / l3^2): factor by which the ratio of neighbouring rows falls per row
  float gain = 1.0f;  // factor on the colour
  int segment = 0;  // rows after which the recurrence restarts

 private:
  static constexpr int kMaxSegment = 16;  // rows; the recurrence's relative error stays below 16^2 / 2 * 6e-8

  // A subnormal scale counts as zero, whether or not the processor flushes it.
  SG_INLINE bool drawable(float l1, float l2, float l3) const {
    constexpr float kLeast = std::numeric_limits<float>::min(), kLargest = std::numeric_limits<float>::max();
    const auto finite = [](float v) SG_INLINE_LAMBDA -> int { return std::abs(v) <= kLargest; };
    return finite(x) & finite(y) & finite(l2) & (l1 >= kLeast) & (l3 >= kLeast) & finite(l1) & finite(l3) &
           finite(1.0f / (l3 * l3)) & finite(shear);
  }
  // The rows of a column segment. A lane with sigma <= kMaxCutoff anywhere in the segment has
  // |z2| < sqrt(2 kMaxCutoff) + rows / l3 in its first row. There sigma must stay below kFar = 80 (columns.h), so
  // rows / l3 may be 9.
  static SG_INLINE int segment_rows(float l3) {
    return static_cast<int>(std::max(1.0f, std::min(static_cast<float>(kMaxSegment), 9.0f * l3)));
  }
};

constexpr float kMargin = 0.01f;  // samples by which an ellipse is widened, far more than its rounding error

// The ellipse at `reach` in a Gaussian's own axes. If single precision overflows, some values are NaN: then the ellipse
// ends at the edges of the grid.
struct Ellipse {
  Ellipse() = default;
  SG_INLINE Ellipse(const Footprint& f, const float* l, float reach)
      : x(f.x), y(f.y), inv_l1(f.inv_l1), shear(f.shear), l3(l[2]), half_width(reach * l[0]) {
    const float height = std::sqrt(l[1] * l[1] + l[2] * l[2]), beyond = reach * height * 1.001f + 1.0f;
    summit = half_width * l[1] / height;
    left = x - half_width - kMargin - 0.5f;
    right = x + half_width + kMargin;
    top = y - beyond;
    bottom = y + beyond;
    first_strip = strip_of(left);
    last_strip = strip_of(right);
  }
  // The strips of a grid that the ellipse may touch, counted from the picture's first; none if last < first.
  SG_INLINE int first_in(const Grid& grid) const { return std::max(first_strip, grid.x / kTileWidth); }
  SG_INLINE int last_in(const Grid& grid) const {
    const int first = grid.x / kTileWidth;
    if (bottom < static_cast<float>(grid.y) || top > static_cast<float>(grid.y + grid.height)) return first - 1;
    return std::min(last_strip, first + grid.strips() - 1);
  }

  float x, y, inv_l1, shear, l3;  // as in the footprint
  float half_width, summit;
  float left, right;  // range of columns
  float top, bottom;  // range of rows, with a margin beyond any rounding error
  int first_strip, last_strip;

 private:
  static constexpr float kFarStrip = 1 << 20;  // beyond every grid
  // The strip of a column; the first for NaN.
  static SG_INLINE int strip_of(float column) {
    const float strip = column / kTileWidth;
    const float within = strip > -kFarStrip ? (strip < kFarStrip ? strip : kFarStrip) : -kFarStrip;
    const int whole = static_cast<int>(within);
    return whole - (static_cast<float>(whole) > within);
  }
};

// The first and last row that an ellipse covers in each of W strips, none if last < first; and the lanes.
template <int W>
struct Crossing {
  typename Simd<W>::I first_row, last_row, first_lane, last_lane;
};

// Crosses an ellipse with W strips of a grid, from `strip` on.
template <int W>
SG_INLINE Crossing<W> cross(const Ellipse& e, int strip, const Grid& grid, float reach) {
  using V = Simd<W>;
  using F = typename V::F;
  using I = typename V::I;
  const auto within = [](F v, F low, F high) SG_INLINE_LAMBDA { return V::min(V::max(v, low), high); };
  const auto whole = [](F v) SG_INLINE_LAMBDA { return __builtin_convertvector(v, I); };
  const auto edge = [&](F dx) SG_INLINE_LAMBDA {
    const F z = dx * e.inv_l1;
    return V::sqrt(V::max0(reach * reach - z * z)) * e.l3;
  };
  F column;
  for (int i = 0; i < W; ++i) column[i] = static_cast<float>(i * kTileWidth);
  column += static_cast<float>(strip * kTileWidth);
  const F half_width = V::all(e.half_width), lanes = V::all(static_cast<float>(kTileWidth - 1));
  const F left = within(column - e.x, -half_width, half_width);
  const F right = within(column + static_cast<float>(kTileWidth) - e.x, -half_width, half_width);
  const F highest = within(V::all(-e.summit), left, right), lowest = within(V::all(e.summit), left, right);
  const F top = V::all(static_cast<float>(grid.y)), bottom = V::all(static_cast<float>(grid.y + grid.height));
  const F above = within(highest * e.shear + e.y - edge(highest) - kMargin - 0.5f, top, bottom);
  const F below = within(lowest * e.shear + e.y + edge(lowest) + kMargin - 0.5f, top - 1.0f, bottom - 1.0f);
  const I first_row = whole(above), last_row = whole(below);
  const I up = __builtin_convertvector(first_row, F)<above, down = __builtin_convertvector(last_row, F)> below;
  return {first_row - up, last_row + down,  // a true comparison is -1
          whole(within(e.left - column, F{}, lanes)), whole(within(e.right - column, F{}, lanes))};
}

// Calls visit(span), counted within the grid, for each strip of a grid in which a Gaussian covers rows.
template <typename Visit>
void spans(const Footprint& f, const float* l, float reach, const Grid& grid, const Visit& visit) {
  constexpr int kTogether = 4;
  if (f.segment == 0) return;
  const Ellipse ellipse(f, l, reach);
  const int first = grid.x / kTileWidth, last = ellipse.last_in(grid);
  for (int strip = ellipse.first_in(grid); strip <= last; strip += kTogether) {
    const Crossing<kTogether> c = cross<kTogether>(ellipse, strip, grid, reach);
    for (int k = 0; k < std::min(kTogether, last + 1 - strip); ++k)
      if (c.first_row[k] <= c.last_row[k])
        visit(Span{strip + k - first, c.first_row[k] - grid.y, c.last_row[k] - grid.y,
                   static_cast<uint8_t>(c.first_lane[k]), static_cast<uint8_t>(c.last_lane[k])});
  }
}

}  // namespace sg
