// The inner loops of fitting and refining, for each instruction set. They may use fused arithmetic (CMakeLists.txt).
#pragma once

#include "core/constants.h"
#include "raster/rasterization.h"

namespace sg {

constexpr int kReducedRows = kTileHeight / 2 + 2;  // of a tile, on the next level
constexpr int kOverRows = 2;  // of these, which overlap with the tile below
constexpr int kMarginFloats = 3 * 3 * kTileWidth;  // three rows: so many samples beyond a tile count in what it reduces to
constexpr int kPairGradients = 8;  // mean x, y; l1, l2, l3; colour r, g, b

// A picture of strips: [strips][height][3][kTileWidth].
struct Strips {
  float* values;
  int width, height;
  float* row(int strip, int row) const {
    return values + (static_cast<int64_t>(strip) * height + row) * (3 * kTileWidth);
  }
};

// Where a tile's part of a target [3][height][width] lies, in which white is kTargetWhite.
struct TileTarget {
  const int16_t* first;
  int64_t plane, stride;  // values from one plane, and from one row, to the next
  int64_t ahead;          // values from a value to the one that is fetched from memory meanwhile, for later
  int columns, rows;      // within the picture
  float scale;            // of the gradient
  const int16_t* visibility = nullptr;  // of the tile's first pixel, its rows as far apart as the target's
  Seen seen = kSeenAlike;               // how much colours count there
};

struct FitKernels {
  // Returns the tile's squared error. pair_gradients [pairs of the tile][kPairGradients]: the gradients of that error
  // times scale / 2. first: room for first_value_count() floats. values: laid out as accumulators are; what lies below the
  // tile's Gaussians comes in, the gradient by the tile's picture leaves.
  double (*squared_error)(const Rasterization&, int tile, const float* colors, const TileTarget&, float* first,
                          float* values, float* pair_gradients);
  // values = (values less the target) times its scale, and 0 beyond the picture. Returns the squared error. Where the target
  // has a visibility, the error counts as it is seen (core/constants.h), and values become half of its gradient.
  double (*difference)(float* values, const TileTarget&);
  // values times the visibility of their pixels, whose rows are `stride` apart.
  void (*weigh)(float* values, const int16_t* visibility, int64_t stride, int columns, int rows);
  // pair_gradients from the gradient by the tile's picture, which is laid out as accumulators are.
  void (*backward)(const Rasterization&, int tile, const float* colors, const float* tile_gradient, float* pair_gradients);
  // Adds what a gradient by the tile's picture comes to on the next level: kReducedRows, of kTileWidth / 2 + 2 samples (what
  // follows up to kTileWidth stays). The first of them, no more than `rows`, to `to`; the last kOverRows to `aside`. There
  // rows have three colours, each `stride` floats long. Before and after the tile lie kMarginFloats zeros.
  void (*reduce)(const float* gradient, int rows, float* to, float* aside, int64_t stride);
  // patch [rows][stride] = the weights of one Gaussian, from the span's first strip on; values between spans stay.
  void (*weights)(const Footprint&, float floor, const Span* spans, int count, int first_row, int64_t stride, float* patch);
  // picture += color [3] times the weights of one Gaussian.
  void (*add)(const Footprint&, float floor, const Span* spans, int count, const float* color, const Strips& picture);
  // products [4]: sums over the picture of its red, green and blue times the weight, and of the squared weight; all of them
  // times the visibility of the pixels [strips][height][kTileWidth], unless that is null.
  void (*project)(const Footprint&, float floor, const Span* spans, int count, const Strips& picture,
                  const float* visibility, float* products);
};

// Floats of the first rows of all column segments of a tile. squared_error needs them twice, and so at once.
int64_t first_value_count(const Rasterization&, int tile);

// Of an instruction set (core/isa.h).
const FitKernels& fit_kernels(int isa);

}  // namespace sg
