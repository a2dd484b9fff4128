// The inner loops of drawing, one tile at a time, for each instruction set.
#pragma once

#include "raster/placed.h"
#include "raster/rasterization.h"

namespace sg {

struct TileKernels {
  // cross_strips() of placed.h.
  void (*cross)(const Placed&, const Grid* grids, const int* first_tile, float reach, Cursor&, Crossings&);
  // accumulators [kTileHeight][3][kTileWidth] += sum over pairs of the tile of colour times weight.
  void (*forward)(const Rasterization&, int tile, const Pair* begin, const Pair* end, const float* colors,
                  float* accumulators);
  // accumulators = background [3] plus a part of the next level, enlarged. coarse: its first sample, in rows of three
  // colours `stride` floats long. rows: number of the tile's rows needed.
  void (*enlarge)(const float* coarse, int64_t stride, int rows, const float* background, float* accumulators);
  // samples = accumulators / 16, as enlarging expects: rows of three colours `stride` floats long.
  void (*sixteenth)(const float* accumulators, int columns, int rows, float* samples, int64_t stride);
  // Pixels [rows][columns][3] of 8 bits, rows `stride` bytes apart, from accumulators clamped to [0, 1].
  void (*bytes)(const float* accumulators, int columns, int rows, uint8_t* pixels, int64_t stride);
};

// The kernels for an instruction set (core/isa.h).
const TileKernels& kernels(int isa);

}  // namespace sg
