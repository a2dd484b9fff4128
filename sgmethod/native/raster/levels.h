// Drawing in a pyramid (docs/format.md, version 2). A wide Gaussian is smooth, so it is drawn on a coarser grid, which
// is enlarged afterwards. The samples of level l are 2^l pixels wide. A Gaussian belongs to the highest level on which
// its minor axis is at least kNarrowest samples long.
//
// Enlarging by two, l times, blurs by a variance of v_l = (1 - 4^-l) / 4 samples of level l along each axis. So the
// Gaussian is drawn narrower and stronger to compensate: its covariance minus v_l I, its colour times the root of the
// ratio of the determinants.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <vector>

#include "core/simd.h"
#include "raster/footprint.h"

namespace sg {

constexpr int kMaxLevel = 12;
constexpr double kNarrowest = 1.4;  // samples

// Sample i of a coarse level has its centre at (i - kBorder + 0.5) 2^l pixels. Enlarging needs one sample beyond each
// edge of the picture; with two, even and odd samples are the same ones on every level.
constexpr int kBorder = 2;
inline int border_of(int level) { return level == 0 ? 0 : kBorder; }

// The level of a Gaussian with factor (l1, l2, l3); 0 if it is not an ellipse. Without a branch, so that the compiler
// vectorises loops over many; and the same on every machine: only arithmetic, roots and comparisons in double
// precision.
SG_INLINE int level_of(const float* factor) {
  const double l1 = factor[0], l2 = factor[1], l3 = factor[2];
  const double a = l1 * l1, c = l2 * l2 + l3 * l3;
  const double minor = 2.0 * (a * l3) * l3 / (a + c + std::sqrt((a - c) * (a - c) + 4.0 * (a * l2) * l2));
  const double squared = minor / (kNarrowest * kNarrowest);  // (samples over kNarrowest)^2
  uint64_t bits;
  std::memcpy(&bits, &squared, sizeof bits);
  const int octaves = static_cast<int>(bits >> 52) - 1023;
  const bool wide = (l1 > 0) & (l3 > 0) & (squared >= 4.0);
  return wide ? std::min(octaves >> 1, kMaxLevel) : 0;
}

// A Gaussian's factor before and after narrowing, in samples of its level.
struct Narrowed {
  SG_INLINE Narrowed(const float* l, int level) {
    const double scale = power_of_two(-level), blur = (1.0 - scale * scale) * 0.25;
    p1 = l[0] * scale, p2 = l[1] * scale, p3 = l[2] * scale;
    const double a = p1 * p1 - blur, b = p1 * p2, c = p2 * p2 + p3 * p3 - blur;
    q1 = std::sqrt(a), q2 = b / q1, q3 = std::sqrt(a * c - b * b) / q1;
  }
  double p1, p2, p3;  // factor before narrowing
  double q1, q2, q3;  // factor after narrowing
};

// A Gaussian to draw, in samples of its level.
struct Levelled {
  SG_INLINE Levelled(const float* m, const float* l, int level) {
    const double scale = power_of_two(-level);
    const Narrowed n(l, level);
    const auto on_level = [level](float pixels, double samples)
                              SG_INLINE_LAMBDA { return level == 0 ? pixels : static_cast<float>(samples); };
    for (int k = 0; k < 2; ++k) mean[k] = on_level(m[k], m[k] * scale + kBorder);
    factor[0] = on_level(l[0], n.q1);
    factor[1] = on_level(l[1], n.q2);
    factor[2] = on_level(l[2], n.q3);
    gain = on_level(1.0f, n.p1 * n.p3 / (n.q1 * n.q3));
  }
  float mean[2], factor[3];
  float gain;  // factor on the colour
};

// The grids of levels 0 to top needed to draw pixels from (x, y) on. Level 0 begins with the tile of the first pixel.
std::vector<Grid> grids_of(int x, int y, int width, int height, int top);

// Along one axis: the first of the next level's samples that are enlarged to a tile beginning at `place`.
inline int coarse_of(int place, int level) { return place / 2 + (level == 0 ? kBorder - 1 : 0); }

}  // namespace sg
