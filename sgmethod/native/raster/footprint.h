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

}  // namespace sg
