// Gaussians placed on the levels of a pyramid, several at a time.
#pragma once

#include "raster/levels.h"

namespace sg {

// One array per value, so that the compiler vectorises loops over Gaussians.
struct Placed {
  static constexpr int kMost = 64;

  Footprint footprint(int i) const {
    Footprint f;
    f.x = x[i], f.y = y[i], f.inv_l1 = inv_l1[i], f.inv_l3 = inv_l3[i], f.shear = shear[i];
    f.decay = decay[i], f.gain = gain[i], f.segment = segment[i];
    return f;
  }
  Ellipse ellipse(int i) const {
    Ellipse e;
    e.x = x[i], e.y = y[i], e.inv_l1 = inv_l1[i], e.shear = shear[i], e.l3 = l3[i];
    e.half_width = half_width[i], e.summit = summit[i], e.left = left[i], e.right = right[i];
    e.top = top[i], e.bottom = bottom[i], e.first_strip = first_strip[i], e.last_strip = last_strip[i];
    return e;
  }

  int first = 0, count = 0;  // Gaussians
  // As in Footprint. The level is 0 if there is nothing to draw.
  alignas(64) int32_t level[kMost] = {}, segment[kMost] = {};
  alignas(64) float x[kMost] = {}, y[kMost] = {}, inv_l1[kMost] = {}, inv_l3[kMost] = {}, shear[kMost] = {};
  alignas(64) float decay[kMost] = {}, gain[kMost] = {};
  // As in Ellipse.
  alignas(64) float l3[kMost] = {}, half_width[kMost] = {}, summit[kMost] = {}, left[kMost] = {}, right[kMost] = {};
  alignas(64) float top[kMost] = {}, bottom[kMost] = {};
  alignas(64) int32_t first_strip[kMost] = {}, last_strip[kMost] = {};
};

// Places `count` Gaussians from `first` on, at most Placed::kMost, of means [n, 2] and factors [n, 3] in pixels.
// Without a pyramid all are on level 0.
void place(const float* means, const float* factors, int first, int count, bool pyramid, float reach, Placed& placed);

// Crossings of Gaussians with strips of tiles.
struct Crossings {
  static constexpr int kMost = 256;
  int count = 0;
  int32_t gaussian[kMost], tile[kMost];  // the tile in which the rows begin
  int32_t within[kMost];                 // rows and lanes within that tile, one byte each, as in Pair
  int32_t last_row[kMost];               // counted from that tile's first
  int32_t blocks[kMost];                 // number of tiles, one below the other; 0 if no rows are covered
};

// The next strip to cross: index of the placed Gaussian, and strip counted from the picture's first.
struct Cursor {
  int gaussian = 0, strip = 0;
};

// Adds crossings of placed Gaussians, from the cursor on, until all are done or `out` is full. grids, first_tile: of
// each level.
template <int W>
SG_INLINE void cross_strips(const Placed& p, const Grid* grids, const int* first_tile, float reach, Cursor& at,
                            Crossings& out) {
  using I = typename Simd<W>::I;
  static_assert(kTileHeight == 64 && kTileWidth <= 256, "rows and lanes are bytes");
  constexpr int kBlockBits = 6;
  const auto put = [&out](int32_t* to, I v) SG_INLINE_LAMBDA { std::memcpy(to + out.count, &v, sizeof v); };
  I step;
  for (int i = 0; i < W; ++i) step[i] = i;
  for (; at.gaussian < p.count; ++at.gaussian, at.strip = 0) {
    if (p.segment[at.gaussian] == 0) continue;
    const Ellipse e = p.ellipse(at.gaussian);
    const int level = p.level[at.gaussian];
    const Grid& grid = grids[level];
    const int last = e.last_in(grid), across = grid.strips();
    for (int strip = std::max(at.strip, e.first_in(grid)); strip <= last; strip += W) {
      if (out.count + W > Crossings::kMost) {
        at.strip = strip;
        return;
      }
      const Crossing<W> c = cross<W>(e, strip, grid, reach);
      const I first_row = c.first_row - grid.y, last_row = c.last_row - grid.y, block = first_row >> kBlockBits;
      const I from = first_row - (block << kBlockBits), to = last_row - (block << kBlockBits);
      const I inside = to < kTileHeight ? to : I{} + (kTileHeight - 1);
      put(out.gaussian, I{} + (p.first + at.gaussian));
      put(out.tile, block * across + step + (first_tile[level] + strip - grid.x / kTileWidth));
      put(out.within, from | inside << 8 | c.first_lane << 16 | c.last_lane << 24);
      put(out.last_row, to);
      put(out.blocks, to < from ? I{} : (to >> kBlockBits) + 1);
      out.count += std::min(W, last + 1 - strip);
    }
  }
}

// exp(-x), rounded from double. Not the C library's, which may differ from machine to machine.
float exp_minus(double x);

// exp(-inv_l3^2), computed in double precision, because it is multiplied up to 120 times in a segment.
float decay_of(float inv_l3);

}  // namespace sg
