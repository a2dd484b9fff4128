// Drawing in a pyramid (docs/format.md, version 4). A wide Gaussian is smooth, so it is drawn on a coarser grid, which is
// enlarged afterwards. The samples of level l are 2^l pixels wide. A Gaussian belongs to the highest level on which its
// minor axis is still kNarrowest samples long.
//
// Enlarging by two, l times, blurs by a variance of v_l = (1 - 4^-l) / 4 samples of level l along each axis. So the
// Gaussian is drawn narrower by that, with more weight: its covariance less v_l I, its colour times the root of the
// ratio of the determinants.
#pragma once

#include <vector>

#include "raster/footprint.h"

namespace sg {

constexpr int kMaxLevel = 12;
constexpr double kNarrowest = 1.4;  // samples

// Sample i of a coarse level has its centre at (i - kBorder + 0.5) 2^l pixels. Enlarging needs one sample beyond each edge
// of the picture; two make the two nearest samples of an even one the same on every level.
constexpr int kBorder = 2;
inline int border_of(int level) { return level == 0 ? 0 : kBorder; }

// The level of a Gaussian of factor (l1, l2, l3). The same on every machine: double precision, root and comparison alone.
int level_of(const float* factor);

// A Gaussian in samples of its level.
struct Levelled {
  Levelled(const float* mean, const float* factor, int level);
  float mean[2], factor[3];
  float gain;  // of its colour
};

// The gradients by a Gaussian's mean [2] and factor [3] in pixels, from those by its mean, factor and gain in samples of
// its level. In place.
void to_pixels(const float* factor, int level, float by_gain, float* by_mean, float* by_factor);

// The grids of levels 0 to top that drawing pixels from (x, y) needs. Level 0 begins with the tile of the first pixel.
std::vector<Grid> grids_of(int x, int y, int width, int height, int top);

// Where the samples from which a tile is enlarged begin, on the next level: for a sample's place along one axis.
inline int coarse_of(int place, int level) { return place / 2 + (level == 0 ? kBorder - 1 : 0); }

}  // namespace sg
