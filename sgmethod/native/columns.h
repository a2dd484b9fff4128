// Down one column the weight of a Gaussian is exp(-sigma) with sigma quadratic in the row, so
//     e[r + 1] = e[r] ratio[r],   ratio[r + 1] = ratio[r] exp(-1 / l3^2):
// two multiplications in place of an exponential. Rounding errors grow with the square of the length and an
// underflow would be for ever, so the recurrence starts anew every `segment` rows, chosen (footprint.cpp)
// such that a lane that matters anywhere in a segment has sigma < kFar at its first row.
#pragma once

#include "rasterization.h"
#include "simd.h"

namespace sg {
namespace {

constexpr float kFar = 80.0f;  // beyond this, a lane stays zero through its segment; exp(-80) is still normal

template <int W>
struct Column {
  typename Simd<W>::F e, ratio;

  // Values at `row` (pixels from the Gaussian's mean, per lane: dx).
  SG_INLINE Column(const Footprint& f, typename Simd<W>::F dx, typename Simd<W>::F z1_half_square, float dy) {
    using V = Simd<W>;
    const typename V::F z2 = (dy - dx * f.shear) * f.inv_l3;
    const typename V::F sigma = z1_half_square + z2 * z2 * 0.5f;
    const typename V::F near = V::exp(-V::min(sigma, V::all(kFar)));
    e = sigma < kFar ? near : typename V::F{};
    const typename V::F slope = (z2 + f.inv_l3 * 0.5f) * f.inv_l3;
    ratio = V::exp(V::min(V::max(-slope, V::all(-kFar)), V::all(kFar)));
  }
};

template <int W>
SG_INLINE typename Simd<W>::F lane_centres(float x) {
  typename Simd<W>::F v;
  for (int i = 0; i < W; ++i) v[i] = x + static_cast<float>(i) + 0.5f;
  return v;
}

// Draws a tile; with kKeep, the first values of each column segment are kept for the gradients, because exponentials are
// most of what a segment costs.
template <int W, bool kKeep>
SG_INLINE void forward_body(const Rasterization& raster, int tile, const float* colors, float* accumulators,
                            [[maybe_unused]] float* kept) {
  using V = Simd<W>;
  const int x0 = (tile % raster.strips()) * kTileWidth;
  const int y0 = (tile / raster.strips()) * kTileHeight;
  const float floor = raster.floor();
  for (const Pair* pair = raster.tile_begin(tile); pair != raster.tile_end(tile); ++pair) {
    const Footprint& f = raster.footprint(pair->gaussian);
    const float* color = colors + 3 * static_cast<int64_t>(pair->gaussian);
    const float c0 = color[0], c1 = color[1], c2 = color[2];
    for (int lane = 0; lane < kTileWidth; lane += W) {
      const typename V::F dx = lane_centres<W>(static_cast<float>(x0 + lane)) - f.x;
      const typename V::F z1 = dx * f.inv_l1;
      const typename V::F z1_half_square = z1 * z1 * 0.5f;
      for (int row = pair->first_row; row <= pair->last_row;) {
        const int end = row + f.segment <= pair->last_row ? row + f.segment : pair->last_row + 1;
        Column<W> c(f, dx, z1_half_square, static_cast<float>(y0 + row) + 0.5f - f.y);
        if constexpr (kKeep) {
          V::store(kept, c.e);
          V::store(kept + W, c.ratio);
          kept += 2 * W;
        }
        float* out = accumulators + row * (3 * kTileWidth) + lane;
        for (; row < end; ++row, out += 3 * kTileWidth) {
          const typename V::F weight = V::max0(c.e - floor);
          V::store(out, V::load(out) + weight * c0);
          V::store(out + kTileWidth, V::load(out + kTileWidth) + weight * c1);
          V::store(out + 2 * kTileWidth, V::load(out + 2 * kTileWidth) + weight * c2);
          c.e *= c.ratio;
          c.ratio *= f.decay;
        }
      }
    }
  }
}

}  // namespace
}  // namespace sg
