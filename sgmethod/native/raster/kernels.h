// The inner loops, one tile at a time, for each instruction set.
#pragma once

#include "raster/placed.h"
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

struct TileKernels {
  // cross_strips() of placed.h.
  void (*cross)(const Placed&, const Grid* grids, const int* first_tile, float reach, Cursor&, Crossings&);
  // accumulators [kTileHeight][3][kTileWidth] += sum over pairs of the tile of colour times weight.
  void (*forward)(const Rasterization&, int tile, const Pair* begin, const Pair* end, const float* colors,
                  float* accumulators);
  // accumulators = background [3] plus a part of the next level, enlarged. coarse: the first of its samples, rows of three
  // colours `stride` floats long. rows: of the tile, as far as they are needed.
  void (*enlarge)(const float* coarse, int64_t stride, int rows, const float* background, float* accumulators);
  // samples = accumulators / 16, as enlarging wants them: rows of three colours `stride` floats long.
  void (*sixteenth)(const float* accumulators, int columns, int rows, float* samples, int64_t stride);
  // Pixels [rows][columns][3] of 8 bits, rows `stride` bytes apart, from accumulators clamped to [0, 1].
  void (*bytes)(const float* accumulators, int columns, int rows, uint8_t* pixels, int64_t stride);
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
const TileKernels& kernels(int isa);
// Defined in fit/, which may use fused arithmetic. They are declared here because a Rasterization hands them its tiles.
const FitKernels& fit_kernels(int isa);

}  // namespace sg
