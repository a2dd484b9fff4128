// One Gaussian over a grid of samples: what the kernels need of it, and which rows it covers in which strip of columns.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>

#include "core/constants.h"

namespace sg {

// exp(-x) rounded from double: the C library's may differ from machine to machine, which pixels must not.
float exp_minus(double x);

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
  Footprint(const float* mean, const float* factor);

  float x, y;            // mean, pixels; pixel (row, column) has its centre at (column + 0.5, row + 0.5)
  float inv_l1, inv_l3;  // 1 / l1, 1 / l3
  float shear;           // l2 / l1
  float decay;           // exp(-1 / l3^2): what the ratio of two neighbouring rows loses per row
  float gain = 1.0f;     // of its colour
  int segment = 0;       // rows after which the recurrence starts anew
};

// Sets the decays of some footprints: together, which takes a fraction of the time.
void set_decays(Footprint* footprints, int count);

// The whole part of v, at least low and at most high. A value that is not a number gives low: geometry that single
// precision cannot hold comes to such values.
inline int clamp_to_int(float v, int low, int high) {
  if (!(v > static_cast<float>(low))) return low;
  return v < static_cast<float>(high) ? static_cast<int>(v) : high;
}
// The same for the next whole number below, and above. Without a call, which the C library's take.
inline int floor_to_int(float v, int low, int high) {
  const int whole = clamp_to_int(v, low, high);
  return whole > low && static_cast<float>(whole) > v ? whole - 1 : whole;
}
inline int ceil_to_int(float v, int low, int high) {
  const int whole = clamp_to_int(v, low, high);
  return whole < high && static_cast<float>(whole) < v ? whole + 1 : whole;
}

// The rows that the ellipse within `reach` of its own axes covers in each strip of a grid. The edge above dx is
// shear dx + l3 sqrt(reach^2 - (dx / l1)^2), concave, with its summit at dx = reach l1 l2 / sqrt(l2^2 + l3^2).
// Calls visit(span), counted within the grid, for each strip in which there are any; returns the strips looked at.
template <typename Visit>
int spans(const Footprint& f, const float* l, float reach, const Grid& grid, const Visit& visit) {
  constexpr float kMargin = 0.01f;  // samples by which a footprint is widened: far more than its rounding error
  if (f.segment == 0) return 0;
  const float half_width = reach * l[0];
  const float half_height = std::sqrt(l[1] * l[1] + l[2] * l[2]);
  const float summit = half_width * l[1] / half_height;
  const float beyond = reach * 1.001f * half_height + 1.0f;  // far more than any rounding error
  const int bottom_row = grid.y + grid.height;
  if (f.y + beyond < static_cast<float>(grid.y) || f.y - beyond > static_cast<float>(bottom_row)) return 0;
  const auto edge = [&](float dx) {
    const float z = dx * f.inv_l1;
    return l[2] * std::sqrt(std::max(reach * reach - z * z, 0.0f));
  };
  const int first = grid.x / kTileWidth, end = first + grid.strips();
  const float from = f.x - half_width - kMargin - 0.5f, to = f.x + half_width + kMargin;  // columns
  const int s0 = floor_to_int(from / kTileWidth, first, end), s1 = floor_to_int(to / kTileWidth, first - 1, end - 1);
  for (int strip = s0; strip <= s1; ++strip) {
    const float left = std::clamp(static_cast<float>(strip * kTileWidth) - f.x, -half_width, half_width);
    const float right = std::clamp(static_cast<float>((strip + 1) * kTileWidth) - f.x, -half_width, half_width);
    const float top_dx = std::clamp(-summit, left, right), bottom_dx = std::clamp(summit, left, right);
    const float top = f.y + f.shear * top_dx - edge(top_dx) - kMargin;
    const float bottom = f.y + f.shear * bottom_dx + edge(bottom_dx) + kMargin;
    const int row0 = ceil_to_int(top - 0.5f, grid.y, bottom_row);
    const int row1 = floor_to_int(bottom - 0.5f, grid.y - 1, bottom_row - 1);
    if (row0 > row1) continue;
    const auto column = static_cast<float>(strip * kTileWidth);
    visit(Span{strip - first, row0 - grid.y, row1 - grid.y,
               static_cast<uint8_t>(clamp_to_int(from - column, 0, kTileWidth - 1)),
               static_cast<uint8_t>(clamp_to_int(to - column, 0, kTileWidth - 1))});
  }
  return std::max(s1 - s0 + 1, 0);
}

}  // namespace sg
