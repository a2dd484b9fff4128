// The inner loops of fitting and refining, for each instruction set, possibly with fused arithmetic (CMakeLists.txt).
#pragma once

#include "core/constants.h"
#include "raster/rasterization.h"

namespace sg {

constexpr int kReducedRows = kTileHeight / 2 + 2;  // rows of the next level to which a tile is reduced
constexpr int kOverRows = 2;  // how many of these overlap with those of the tile below
constexpr int kMarginFloats = 3 * 3 * kTileWidth;  // three rows of zeros, which reducing reads beyond a tile
constexpr int kPairGradients = 8;  // mean x, y; l1, l2, l3; colour r, g, b

// A picture stored in strips: [strips][height][3][kTileWidth].
struct Strips {
  float* values;
  int width, height;
  float* row(int strip, int row) const {
    return values + (static_cast<int64_t>(strip) * height + row) * (3 * kTileWidth);
  }
};

// The squared mean of an error over squares of `side` pixels (1, 2 or 4) counts once more, `weight` times.
struct Coarse {
  // spacing: side of a pixel, in pixels of the whole picture.
  static Coarse at(float weight, int spacing) { return {weight, spacing < kCoarseSide ? kCoarseSide / spacing : 1}; }
  float weight = 0;
  int side = 1;
};

// A tile's part of a target [3][height][width], in which white is kTargetWhite.
struct TileTarget {
  const int16_t* first;
  int64_t plane, stride;  // values from one plane, and from one row, to the next
  int64_t ahead;          // distance, in values, to prefetch
  int columns, rows;      // within the picture
  float scale;            // of the gradient
  const int16_t* visibility = nullptr;  // of the tile's first pixel, rows `stride` apart
  Seen seen = kSeenAlike;               // weights of colours, with a visibility
  Coarse coarse = {};                   // with a visibility
};

struct FitKernels {
  // Returns the tile's squared error. pair_gradients [pairs of the tile][kPairGradients]: the gradients of that error
  // times scale / 2. first: memory for first_value_count() floats. values, in the layout of accumulators: on input, the
  // tile below its own Gaussians; on output, the gradient by the tile's picture.
  double (*squared_error)(const Rasterization&, int tile, const float* colors, const TileTarget&, float* first,
                          float* values, float* pair_gradients);
  // values = (values - target) * scale, and 0 beyond the picture. Returns the squared error, without a visibility.
  double (*difference)(float* values, const TileTarget&);
  // Multiplies values by the visibility of their pixels, whose rows are `stride` apart.
  void (*weigh)(float* values, const int16_t* visibility, int64_t stride, int columns, int rows);
  // pair_gradients from the gradient by the tile's picture, in the layout of accumulators.
  void (*backward)(const Rasterization&, int tile, const float* colors, const float* tile_gradient,
                   float* pair_gradients);
  // Reduces a gradient by the tile's picture to the next level, and adds it there: kReducedRows rows of kTileWidth / 2
  // + 2 samples, up to `rows` of the first ones to `to`, the last kOverRows to `aside`. There rows have three colours,
  // each `stride` floats long. The tile must have kMarginFloats zeros before and after it.
  void (*reduce)(const float* gradient, int rows, float* to, float* aside, int64_t stride);
  // patch [rows][stride] = the weights of one Gaussian, from the first span's strip on; values outside spans are kept.
  void (*weights)(const Footprint&, float floor, const Span* spans, int count, int first_row, int64_t stride,
                  float* patch);
  // picture += color [3] times the weights of one Gaussian.
  void (*add)(const Footprint&, float floor, const Span* spans, int count, const float* color, const Strips& picture);
  // products [4]: sums over the picture of its red, green and blue times the weight, and of the squared weight, all
  // times the visibility [strips][height][kTileWidth] unless that is null.
  void (*project)(const Footprint&, float floor, const Span* spans, int count, const Strips& picture,
                  const int16_t* visibility, float* products);
};

// Number of floats for the first rows of all column segments of a tile, which squared_error keeps to use them twice.
int64_t first_value_count(const Rasterization&, int tile);

// The kernels for an instruction set (core/isa.h).
const FitKernels& fit_kernels(int isa);

}  // namespace sg
