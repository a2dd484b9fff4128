// Which rows and lanes a Gaussian covers in which strip of columns.
//
// The edge of the ellipse above dx is shear dx + l3 sqrt(reach^2 - (dx / l1)^2), concave, with its summit at
// dx = reach l1 l2 / sqrt(l2^2 + l3^2). Many strips are computed at once: by themselves they would wait for their roots, and
// for branches that no processor foresees.
#pragma once

#include "core/simd.h"
#include "raster/footprint.h"

namespace sg {

constexpr int kManyStrips = 128;
constexpr float kMargin = 0.01f;  // samples by which an ellipse is widened: far more than its rounding error

// The ellipse within `reach` of a Gaussian's own axes.
struct Ellipse {
  Ellipse() = default;
  Ellipse(const Footprint& f, const float* l, float reach)
      : x(f.x), y(f.y), inv_l1(f.inv_l1), shear(f.shear), l3(l[2]), half_width(reach * l[0]) {
    const float height = std::sqrt(l[1] * l[1] + l[2] * l[2]);
    half_height = reach * height;
    summit = half_width * l[1] / height;
    left = x - half_width - kMargin - 0.5f;
    right = x + half_width + kMargin;
  }
  // The strips of a grid that it may touch, counted from the picture's first; none where last < first.
  int first_strip(const Grid& grid) const {
    const int first = grid.x / kTileWidth;
    return floor_to_int(left / kTileWidth, first, first + grid.strips());
  }
  int last_strip(const Grid& grid) const {
    const int first = grid.x / kTileWidth;
    const float beyond = half_height * 1.001f + 1.0f;  // far more than any rounding error
    if (y + beyond < static_cast<float>(grid.y) || y - beyond > static_cast<float>(grid.y + grid.height)) return first - 1;
    return floor_to_int(right / kTileWidth, first - 1, first + grid.strips() - 1);
  }

  float x, y, inv_l1, shear, l3;  // as in the footprint
  float half_width, half_height, summit;
  float left, right;  // columns between which it lies
};

// Up to kMost strips that ellipses may touch.
template <int kMost>
struct Crossings {
  int count = 0;
  int32_t gaussian[kMost], strip[kMost];
  alignas(64) float x[kMost] = {}, y[kMost] = {}, inv_l1[kMost] = {}, shear[kMost] = {}, l3[kMost] = {};
  alignas(64) float half_width[kMost] = {}, summit[kMost] = {}, left[kMost] = {}, right[kMost] = {};
  alignas(64) float column[kMost] = {};  // of the strip
  alignas(64) float top[kMost] = {}, bottom[kMost] = {};  // rows of the grid; the last, exclusive
  // What cross() finds. Rows are none where last < first.
  alignas(64) int32_t first_row[kMost], last_row[kMost], first_lane[kMost], last_lane[kMost];

  // Rows of tiles; 0 where there are no rows.
  int blocks(int k) const {
    return first_row[k] > last_row[k] ? 0 : last_row[k] / kTileHeight - first_row[k] / kTileHeight + 1;
  }
  void add(int index, int at, const Ellipse& e, const Grid& grid) {
    const int k = count++;
    gaussian[k] = index, strip[k] = at;
    x[k] = e.x, y[k] = e.y, inv_l1[k] = e.inv_l1, shear[k] = e.shear, l3[k] = e.l3;
    half_width[k] = e.half_width, summit[k] = e.summit, left[k] = e.left, right[k] = e.right;
    column[k] = static_cast<float>(at * kTileWidth);
    top[k] = static_cast<float>(grid.y), bottom[k] = static_cast<float>(grid.y + grid.height);
  }
};

template <int W, int kMost>
SG_INLINE void cross(Crossings<kMost>& c, float reach) {
  using V = Simd<W>;
  using F = typename V::F;
  using I = typename V::I;
  const auto within = [](F v, F low, F high) SG_INLINE_LAMBDA { return V::min(V::max(v, low), high); };
  // A value that is not a number gives the lowest: geometry that single precision cannot hold comes to such values.
  const auto whole = [](F v) SG_INLINE_LAMBDA { return __builtin_convertvector(v, I); };
  const auto put = [](int32_t* to, I v) SG_INLINE_LAMBDA { std::memcpy(to, &v, sizeof v); };
  for (int k = 0; k < c.count; k += W) {
    const F x = V::load(c.x + k), y = V::load(c.y + k), inv_l1 = V::load(c.inv_l1 + k), l3 = V::load(c.l3 + k);
    const F shear = V::load(c.shear + k), half_width = V::load(c.half_width + k), summit = V::load(c.summit + k);
    const F column = V::load(c.column + k), top = V::load(c.top + k), bottom = V::load(c.bottom + k);
    const auto edge = [&](F dx) SG_INLINE_LAMBDA {
      const F z = dx * inv_l1;
      return l3 * V::sqrt(V::max0(reach * reach - z * z));
    };
    const F left = within(column - x, -half_width, half_width);
    const F right = within(column + static_cast<float>(kTileWidth) - x, -half_width, half_width);
    const F highest = within(-summit, left, right), lowest = within(summit, left, right);
    const F above = within(y + shear * highest - edge(highest) - kMargin - 0.5f, top, bottom);
    const F below = within(y + shear * lowest + edge(lowest) + kMargin - 0.5f, top - 1.0f, bottom - 1.0f);
    const I first_row = whole(above), last_row = whole(below);
    const I up = __builtin_convertvector(first_row, F) < above, down = __builtin_convertvector(last_row, F) > below;
    put(c.first_row + k, first_row - up);  // a comparison that holds is -1
    put(c.last_row + k, last_row + down);
    const F lanes = V::all(static_cast<float>(kTileWidth - 1));
    put(c.first_lane + k, whole(within(V::load(c.left + k) - column, F{}, lanes)));
    put(c.last_lane + k, whole(within(V::load(c.right + k) - column, F{}, lanes)));
  }
}

// The rows that a Gaussian covers in each strip of a grid. Calls visit(span), counted within the grid, for each strip in
// which there are any.
template <typename Visit>
void spans(const Footprint& f, const float* l, float reach, const Grid& grid, const Visit& visit) {
  if (f.segment == 0) return;
  const Ellipse ellipse(f, l, reach);
  const int first = grid.x / kTileWidth, last = ellipse.last_strip(grid);
  for (int strip = ellipse.first_strip(grid); strip <= last;) {
    Crossings<8> c;
    for (; c.count < 8 && strip <= last; ++strip) c.add(0, strip, ellipse, grid);
    cross<4>(c, reach);
    for (int k = 0; k < c.count; ++k)
      if (c.first_row[k] <= c.last_row[k])
        visit(Span{c.strip[k] - first, c.first_row[k] - grid.y, c.last_row[k] - grid.y,
                   static_cast<uint8_t>(c.first_lane[k]), static_cast<uint8_t>(c.last_lane[k])});
  }
}

}  // namespace sg
