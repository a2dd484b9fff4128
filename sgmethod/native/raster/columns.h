// Weights of Gaussians by recurrence. The weight is exp(-sigma), and down one column sigma is quadratic in the row. So
//     e[r + 1] = e[r] ratio[r],   ratio[r + 1] = ratio[r] exp(-1 / l3^2):
// two multiplications replace an exponential. The recurrence must not run for long, because its rounding error grows
// with the square of the number of rows, and a value that has underflowed stays zero. So it restarts after every column
// segment of `segment` rows. footprint.h chooses that number so that a lane whose weight is visible anywhere in a
// segment has sigma < kFar in the segment's first row.
#pragma once

#include "core/simd.h"
#include "raster/rasterization.h"

namespace sg {
namespace {

constexpr float kFar = 80.0f;  // a lane beyond is zero in the whole segment; exp(-80) is still a normal number

// exp(-sigma) in one row, and the ratio of the next row's to it.
template <int W>
struct Column {
  typename Simd<W>::F e, ratio;
};

template <int W>
SG_INLINE typename Simd<W>::F lane_centres(float x) {
  typename Simd<W>::F v{};
  for (int i = 0; i < W; ++i) v[i] = x + static_cast<float>(i) + 0.5f;
  return v;
}

// Start of a column segment: the left edge of the first of W columns, and the top edge of the row, in pixels.
struct Start {
  const Footprint* f;
  float x, y;
};

// The values at N starts, computed together, because they are independent and each has a long latency.
template <int W, int N>
SG_INLINE void columns(const Start* starts, Column<W>* out) {
  using V = Simd<W>;
  using F = typename V::F;
  F sigma[N], exps[2 * N];
#pragma GCC unroll 4
  for (int i = 0; i < N; ++i) {
    const Footprint& f = *starts[i].f;
    const F dx = lane_centres<W>(starts[i].x) - f.x;
    const F z1 = dx * f.inv_l1;
    const F z2 = (starts[i].y + 0.5f - f.y - dx * f.shear) * f.inv_l3;
    sigma[i] = z1 * z1 * 0.5f + z2 * z2 * 0.5f;
    const F slope = (z2 + f.inv_l3 * 0.5f) * f.inv_l3;
    exps[2 * i] = -V::min(sigma[i], V::all(kFar));
    exps[2 * i + 1] = V::min(V::max(-slope, V::all(-kFar)), V::all(kFar));
  }
  V::exp(exps);
  for (int i = 0; i < N; ++i) out[i] = {sigma[i] < kFar ? exps[2 * i] : F{}, exps[2 * i + 1]};
}

template <int W>
SG_INLINE Column<W> column(const Start& start) {
  Column<W> c[1];
  columns<W, 1>(&start, c);
  return c[0];
}

// The first row after the column segment that begins at `row`. Each kernel has its own loop over segments: in a shared
// one that calls the kernel's body, the compiler kept the sums of the gradients in memory, which took a fifth more
// time.
SG_INLINE int segment_end(const Footprint& f, int row, int last_row) {
  return row + f.segment <= last_row ? row + f.segment : last_row + 1;
}

// The lanes of a pair, rounded to whole vectors.
template <int W>
SG_INLINE int lanes_begin(const Pair& pair) {
  return pair.first_lane / W * W;
}
template <int W>
SG_INLINE int lanes_end(const Pair& pair) {
  return pair.last_lane / W * W + W;
}

// Some of a tile's pairs. first: values in the first row of each of their column segments, at most 2 kTileWidth floats
// per segment, in the order in which first_values() writes and next_column() reads them.
struct Batch {
  const Pair *begin, *end;
  const float* first;
};

SG_INLINE int segments(const Rasterization& raster, const Pair& pair) {
  const int segment = raster.footprint(pair.gaussian).segment;
  return (pair.last_row - pair.first_row + segment) / segment;
}

template <int W, int N>
SG_INLINE void store_columns(const Start* starts, float* first) {
  Column<W> values[N];
  columns<W, N>(starts, values);
  for (int i = 0; i < N; ++i) {
    Simd<W>::store(first + 2 * i * W, values[i].e);
    Simd<W>::store(first + (2 * i + 1) * W, values[i].ratio);
  }
}

// Computes the values in the first rows of column segments, in advance, because the loops over rows would have to wait
// for each exponential.
template <int W>
SG_INLINE void first_values(const Rasterization& raster, int tile, const Pair* begin, const Pair* end, float* first) {
  constexpr int kTogether = W == 16 ? 4 : 2;  // limited by the number of registers
  const int x0 = raster.tile_x(tile), y0 = raster.tile_y(tile);
  Start starts[kTogether];
  int waiting = 0;
  for (const Pair* pair = begin; pair != end; ++pair) {
    const Footprint& f = raster.footprint(pair->gaussian);
    for (int lane = lanes_begin<W>(*pair); lane < lanes_end<W>(*pair); lane += W)
      for (int row = pair->first_row; row <= pair->last_row; row += f.segment) {
        starts[waiting++] = {&f, static_cast<float>(x0 + lane), static_cast<float>(y0 + row)};
        if (waiting < kTogether) continue;
        store_columns<W, kTogether>(starts, first);
        first += kTogether * 2 * W;
        waiting = 0;
      }
  }
  for (int i = 0; i < waiting; ++i, first += 2 * W) store_columns<W, 1>(starts + i, first);
}

template <int W>
SG_INLINE Column<W> next_column(const float*& first) {
  first += 2 * W;
  return {Simd<W>::load(first - 2 * W), Simd<W>::load(first - W)};
}

// Calls draw(batch) for pairs of a tile, in batches that fit a small array.
template <int W, typename Draw>
SG_INLINE void for_batches(const Rasterization& raster, int tile, const Pair* begin, const Pair* last,
                           const Draw& draw) {
  constexpr int kMost = 2 * kTileHeight;  // segments of a batch; one pair has at most kTileHeight
  alignas(64) float first[kMost * 2 * kTileWidth];
  while (begin != last) {
    const Pair* end = begin;
    for (int count = 0; end != last; ++end) {
      count += segments(raster, *end);
      if (count > kMost) break;
    }
    first_values<W>(raster, tile, begin, end, first);
    draw(Batch{begin, end, first});
    begin = end;
  }
}

// Adds a batch to the tile's picture.
template <int W>
SG_INLINE void add_batch(const Rasterization& raster, const Batch& batch, const float* colors, float* accumulators) {
  using V = Simd<W>;
  const float floor = raster.floor();
  const float* first = batch.first;
  for (const Pair* pair = batch.begin; pair != batch.end; ++pair) {
    const Footprint& f = raster.footprint(pair->gaussian);
    const float* color = colors + 3 * static_cast<int64_t>(pair->gaussian);
    const float c0 = color[0] * f.gain, c1 = color[1] * f.gain, c2 = color[2] * f.gain;
    for (int lane = lanes_begin<W>(*pair); lane < lanes_end<W>(*pair); lane += W) {
      for (int row = pair->first_row; row <= pair->last_row;) {
        const int end = segment_end(f, row, pair->last_row);
        Column<W> c = next_column<W>(first);
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
