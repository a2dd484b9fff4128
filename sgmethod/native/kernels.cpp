// Down one column the weight of a Gaussian is exp(-sigma) with sigma quadratic in the row, so
//     e[r + 1] = e[r] ratio[r],   ratio[r + 1] = ratio[r] exp(-1 / l3^2):
// two multiplications in place of an exponential. Rounding errors grow with the square of the length and an
// underflow would be for ever, so the recurrence starts anew every `segment` rows, chosen (rasterization.cpp)
// such that a lane that matters anywhere in a segment has sigma < kFar at its first row.
#include "kernels.h"

#include "simd.h"

namespace sg {
namespace {

constexpr float kFar = 80.0f;  // beyond this, a lane stays zero through its segment; exp(-80) is still normal

template <int W>
struct Column {
  typename Simd<W>::F e, ratio, z2;

  // Values at `row` (pixels from the Gaussian's mean, per lane: dx).
  SG_INLINE Column(const Footprint& f, typename Simd<W>::F dx, typename Simd<W>::F z1_half_square, float dy) {
    using V = Simd<W>;
    z2 = (dy - dx * f.shear) * f.inv_l3;
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

template <int W>
SG_INLINE void forward_body(const Rasterization& raster, int tile, const float* colors, float* accumulators) {
  using V = Simd<W>;
  const int x0 = (tile % raster.strips()) * kTileWidth;
  const int y0 = (tile / raster.strips()) * kTileHeight;
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
        float* out = accumulators + row * (3 * kTileWidth) + lane;
        for (; row < end; ++row, out += 3 * kTileWidth) {
          const typename V::F weight = V::max0(c.e - kFloor);
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

// With g = (dL/dweight) e inside the ellipse, dL/dsigma = -g, and all gradients of the geometry follow from
// the moments of g: sum of g z1, g z2, g z1^2, g z1 z2, g z2^2. z1 is constant in a lane.
template <int W>
SG_INLINE void backward_body(const Rasterization& raster, int tile, const float* colors, const float* tile_gradient,
                             float* pair_gradients) {
  using V = Simd<W>;
  using F = typename V::F;
  const int x0 = (tile % raster.strips()) * kTileWidth;
  const int y0 = (tile / raster.strips()) * kTileHeight;
  for (const Pair* pair = raster.tile_begin(tile); pair != raster.tile_end(tile); ++pair) {
    const Footprint& f = raster.footprint(pair->gaussian);
    const float* color = colors + 3 * static_cast<int64_t>(pair->gaussian);
    const float c0 = color[0], c1 = color[1], c2 = color[2];
    F d0{}, d1{}, d2{}, m1{}, m2{}, m11{}, m12{}, m22{};
    for (int lane = 0; lane < kTileWidth; lane += W) {
      const F dx = lane_centres<W>(static_cast<float>(x0 + lane)) - f.x;
      const F z1 = dx * f.inv_l1;
      const F z1_half_square = z1 * z1 * 0.5f;
      F g0{}, g2{}, g22{};
      for (int row = pair->first_row; row <= pair->last_row;) {
        const int end = row + f.segment <= pair->last_row ? row + f.segment : pair->last_row + 1;
        Column<W> c(f, dx, z1_half_square, static_cast<float>(y0 + row) + 0.5f - f.y);
        const float* in = tile_gradient + row * (3 * kTileWidth) + lane;
        for (; row < end; ++row, in += 3 * kTileWidth) {
          const F i0 = V::load(in), i1 = V::load(in + kTileWidth), i2 = V::load(in + 2 * kTileWidth);
          const F weight = V::max0(c.e - kFloor);
          d0 += weight * i0;
          d1 += weight * i1;
          d2 += weight * i2;
          const F slope = (i0 * c0 + i1 * c1 + i2 * c2) * c.e;
          const F g = c.e > kFloor ? slope : F{};
          const F gz = g * c.z2;
          g0 += g;
          g2 += gz;
          g22 += gz * c.z2;
          c.e *= c.ratio;
          c.ratio *= f.decay;
          c.z2 += f.inv_l3;
        }
      }
      m1 += g0 * z1;
      m2 += g2;
      m11 += g0 * z1 * z1;
      m12 += g2 * z1;
      m22 += g22;
    }
    const float s1 = V::sum(m1), s2 = V::sum(m2), s11 = V::sum(m11), s12 = V::sum(m12), s22 = V::sum(m22);
    pair_gradients[0] = s1 * f.inv_l1 - s2 * f.shear * f.inv_l3;
    pair_gradients[1] = s2 * f.inv_l3;
    pair_gradients[2] = s11 * f.inv_l1 - s12 * f.shear * f.inv_l3;
    pair_gradients[3] = s12 * f.inv_l3;
    pair_gradients[4] = s22 * f.inv_l3;
    pair_gradients[5] = V::sum(d0);
    pair_gradients[6] = V::sum(d1);
    pair_gradients[7] = V::sum(d2);
    pair_gradients += kPairGradients;
  }
}

#define SG_KERNELS(name, width, attribute)                                                                        \
  attribute void forward_##name(const Rasterization& r, int tile, const float* colors, float* accumulators) {     \
    forward_body<width>(r, tile, colors, accumulators);                                                           \
  }                                                                                                               \
  attribute void backward_##name(const Rasterization& r, int tile, const float* colors, const float* gradient,    \
                                 float* pair_gradients) {                                                         \
    backward_body<width>(r, tile, colors, gradient, pair_gradients);                                              \
  }                                                                                                               \
  constexpr TileKernels k_##name = {forward_##name, backward_##name};

SG_KERNELS(baseline, 4, )
SG_KERNELS(avx2, 8, [[gnu::target("avx2")]])
SG_KERNELS(avx512, 16, [[gnu::target("avx512f,avx512dq,avx512vl,prefer-vector-width=512")]])

}  // namespace

int best_isa() {
  if (__builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512dq") && __builtin_cpu_supports("avx512vl"))
    return kAvx512;
  return __builtin_cpu_supports("avx2") ? kAvx2 : kBaseline;
}

const TileKernels& kernels(int isa) {
  static const TileKernels* const table[] = {&k_baseline, &k_avx2, &k_avx512};
  return *table[isa];
}

}  // namespace sg
