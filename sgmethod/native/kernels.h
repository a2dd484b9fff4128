// The inner loops, one tile at a time, for each instruction set.
#pragma once

#include "rasterization.h"

namespace sg {

enum Isa { kBaseline = 0, kAvx2 = 1, kAvx512 = 2 };

// The best instruction set this processor has.
int best_isa();

constexpr int kPairGradients = 8;  // mean x, y; l1, l2, l3; colour r, g, b

struct TileKernels {
  // accumulators [kTileHeight][3][kTileWidth] += sum over the tile's Gaussians of colour times weight.
  void (*forward)(const Rasterization&, int tile, const float* colors, float* accumulators);
  // pair_gradients [pairs of the tile][kPairGradients] from the tile's image gradient, laid out as above.
  void (*backward)(const Rasterization&, int tile, const float* colors, const float* tile_gradient, float* pair_gradients);
};

const TileKernels& kernels(int isa);

}  // namespace sg
