// One Gaussian over a grid of samples: what the kernels need of it, and which rows and lanes it covers in which strip of
// columns.
//
// The edge of its ellipse above dx is shear dx + l3 sqrt(reach^2 - (dx / l1)^2), concave, with its summit at
// dx = reach l1 l2 / sqrt(l2^2 + l3^2). A vector has neighbouring strips of one Gaussian.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>

#include "core/constants.h"
#include "core/simd.h"

namespace sg {

// A part of a picture's samples, or of those of a coarser level (levels.h). It begins where a tile begins, so that a
// tile's values do not depend on the part that is drawn.
struct Grid {
  int x = 0, y = 0;  // of the first sample; multiples of kTileWidth and kTileHeight
  int width = 0, height = 0;
  int strips() const { return (width + kTileWidth - 1) / kTileWidth; }
  int blocks() const { return (height + kTileHeight - 1) / kTileHeight; }
  int tiles() const { return strips() * blocks(); }
};

// A run of rows in one strip of columns, and the lanes within which they lie; all inclusive.
struct Span {
  int strip, first_row, last_row;
  uint8_t first_lane, last_lane;
};

// One Gaussian prepared for the kernels. z1 = dx / l1, z2 = (dy - shear dx) / l3, sigma = (z1^2 + z2^2) / 2.
struct Footprint {
  Footprint() = default;
  // Left at segment 0 if the values are not finite or l1 or l3 not positive: nothing is to be drawn. All but the decay.
  // Without a branch: of loops over many the compiler makes vectors.
  SG_INLINE Footprint(const float* mean, const float* factor)
      : x(mean[0]), y(mean[1]), inv_l1(1.0f / factor[0]), inv_l3(1.0f / factor[2]), shear(factor[1] / factor[0]),
        segment(drawable(factor[0], factor[1], factor[2]) ? segment_rows(factor[2]) : 0) {}

  float x, y;            // mean, pixels; pixel (row, column) has its centre at (column + 0.5, row + 0.5)
  float inv_l1, inv_l3;  // 1 / l1, 1 / l3
  float shear;           // l2 / l1
  float decay = 0.0f;    // exp(-1 / l3^2): what the ratio of two neighbouring rows loses per row
  float gain = 1.0f;     // of its colour
  int segment = 0;       // rows after which the recurrence starts anew

 private:
  static constexpr int kMaxSegment = 16;  // rows; the recurrence's relative error stays below 16^2 / 2 * 6e-8

  // A subnormal scale is none, whether or not the processor makes it zero.
  SG_INLINE bool drawable(float l1, float l2, float l3) const {
    constexpr float kLeast = std::numeric_limits<float>::min();
    const auto finite = [](float v) SG_INLINE_LAMBDA -> int { return std::abs(v) <= std::numeric_limits<float>::max(); };
    return finite(x) & finite(y) & finite(l2) & (l1 >= kLeast) & (l3 >= kLeast) & finite(l1) & finite(l3) & finite(inv_l1) &
           finite(1.0f / (l3 * l3)) & finite(shear);
  }
  // The rows of a column segment. Where a lane has sigma <= kMaxCutoff somewhere in the segment, it has
  // |z2| < sqrt(2 kMaxCutoff) + rows / l3 in the first row. There sigma must stay below kFar = 80 (columns.h), so
  // rows / l3 may be 9.
  static SG_INLINE int segment_rows(float l3) {
    return static_cast<int>(std::max(1.0f, std::min(static_cast<float>(kMaxSegment), 9.0f * l3)));
  }
};

constexpr float kMargin = 0.01f;  // samples by which an ellipse is widened: far more than its rounding error

// The ellipse within `reach` of a Gaussian's own axes. What single precision cannot hold makes some of it no number: then
// it ends at the edges of the grid.
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
  // The strips of a grid that it may touch, counted from the picture's first; none where last < first.
  SG_INLINE int first_in(const Grid& grid) const { return std::max(first_strip, grid.x / kTileWidth); }
  SG_INLINE int last_in(const Grid& grid) const {
    const int first = grid.x / kTileWidth;
    if (bottom < static_cast<float>(grid.y) || top > static_cast<float>(grid.y + grid.height)) return first - 1;
    return std::min(last_strip, first + grid.strips() - 1);
  }

  float x, y, inv_l1, shear, l3;  // as in the footprint
  float half_width, summit;
  float left, right;  // columns between which it lies
  float top, bottom;  // rows, further apart than any rounding error could bring them
  int first_strip, last_strip;

 private:
  static constexpr float kFarStrip = 1 << 20;  // beyond every grid
  // The strip of a column. No number gives the first.
  static SG_INLINE int strip_of(float column) {
    const float strip = column / kTileWidth;
    const float within = strip > -kFarStrip ? (strip < kFarStrip ? strip : kFarStrip) : -kFarStrip;
    const int whole = static_cast<int>(within);
    return whole - (static_cast<float>(whole) > within);
  }
};

// The first and last row of a grid that an ellipse covers in each of W strips, none where last < first; and the lanes.
template <int W>
struct Crossing {
  typename Simd<W>::I first_row, last_row, first_lane, last_lane;
};

// From `strip` on.
template <int W>
SG_INLINE Crossing<W> cross(const Ellipse& e, int strip, const Grid& grid, float reach) {
  using V = Simd<W>;
  using F = typename V::F;
  using I = typename V::I;
  const auto within = [](F v, F low, F high) SG_INLINE_LAMBDA { return V::min(V::max(v, low), high); };
  // A value that is not a number gives the lowest: geometry that single precision cannot hold comes to such values.
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
  const I up = __builtin_convertvector(first_row, F) < above, down = __builtin_convertvector(last_row, F) > below;
  return {first_row - up, last_row + down,  // a comparison that holds is -1
          whole(within(e.left - column, F{}, lanes)), whole(within(e.right - column, F{}, lanes))};
}

// The rows that a Gaussian covers in each strip of a grid. Calls visit(span), counted within the grid, for each strip in
// which there are any.
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
