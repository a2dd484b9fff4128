// Down one column the weight of a Gaussian is exp(-sigma) with sigma quadratic in the row, so
//     e[r + 1] = e[r] ratio[r],   ratio[r + 1] = ratio[r] exp(-1 / l3^2):
// two multiplications in place of an exponential. Rounding errors grow with the square of the length and an
// underflow would be for ever, so the recurrence starts anew every `segment` rows, chosen (footprint.cpp)
// such that a lane that matters anywhere in a segment has sigma < kFar at its first row.
#include "kernels.h"

#include <emmintrin.h>

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

// With g = (dL/dweight) e inside the ellipse, dL/dsigma = -g, and all gradients of the geometry follow from
// the moments of g: sum of g z1, g z2, g z1^2, g z1 z2, g z2^2. z1 is constant in a lane.
template <int W>
SG_INLINE void backward_body(const Rasterization& raster, int tile, const float* colors, const float* tile_gradient,
                             float* pair_gradients) {
  using V = Simd<W>;
  using F = typename V::F;
  const int x0 = (tile % raster.strips()) * kTileWidth;
  const int y0 = (tile / raster.strips()) * kTileHeight;
  const float floor = raster.floor();
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
          const F weight = V::max0(c.e - floor);
          d0 += weight * i0;
          d1 += weight * i1;
          d2 += weight * i2;
          const F slope = (i0 * c0 + i1 * c1 + i2 * c2) * c.e;
          const F g = c.e > floor ? slope : F{};
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

// Calls visit(weights, values of the picture) for each row and vector of lanes of one Gaussian.
template <int W, typename Visit>
SG_INLINE void for_weights(const Footprint& f, float floor, const Span* spans, int count, const Strips& picture, const Visit& visit) {
  using V = Simd<W>;
  for (const Span* span = spans; span != spans + count; ++span) {
    const int x0 = span->strip * kTileWidth;
    for (int lane = 0; lane < kTileWidth; lane += W) {
      const typename V::F centres = lane_centres<W>(static_cast<float>(x0 + lane));
      const typename V::F dx = centres - f.x;
      const typename V::F z1 = dx * f.inv_l1;
      const typename V::F z1_half_square = z1 * z1 * 0.5f;
      const typename V::F inside = centres < static_cast<float>(picture.width) ? V::all(1.0f) : typename V::F{};
      for (int row = span->first_row; row <= span->last_row;) {
        const int end = row + f.segment <= span->last_row ? row + f.segment : span->last_row + 1;
        Column<W> c(f, dx, z1_half_square, static_cast<float>(row) + 0.5f - f.y);
        float* values = picture.row(span->strip, row) + lane;
        for (; row < end; ++row, values += 3 * kTileWidth) {
          visit(V::max0(c.e - floor) * inside, values);
          c.e *= c.ratio;
          c.ratio *= f.decay;
        }
      }
    }
  }
}

template <int W>
SG_INLINE void add_body(const Footprint& f, float floor, const Span* spans, int count, const float* color, const Strips& picture) {
  using V = Simd<W>;
  const float c0 = color[0], c1 = color[1], c2 = color[2];
  for_weights<W>(f, floor, spans, count, picture, [&](typename V::F weight, float* values) SG_INLINE_LAMBDA {
    V::store(values, V::load(values) + weight * c0);
    V::store(values + kTileWidth, V::load(values + kTileWidth) + weight * c1);
    V::store(values + 2 * kTileWidth, V::load(values + 2 * kTileWidth) + weight * c2);
  });
}

template <int W>
SG_INLINE void project_body(const Footprint& f, float floor, const Span* spans, int count, const Strips& picture, float* products) {
  using V = Simd<W>;
  typename V::F p0{}, p1{}, p2{}, square{};
  for_weights<W>(f, floor, spans, count, picture, [&](typename V::F weight, float* values) SG_INLINE_LAMBDA {
    p0 += weight * V::load(values);
    p1 += weight * V::load(values + kTileWidth);
    p2 += weight * V::load(values + 2 * kTileWidth);
    square += weight * weight;
  });
  products[0] = V::sum(p0);
  products[1] = V::sum(p1);
  products[2] = V::sum(p2);
  products[3] = V::sum(square);
}

// Red, green and blue of 16 columns, interleaved: first red and green to their places, then blue between them.
typedef uint8_t Bytes __attribute__((vector_size(16)));

SG_INLINE __m128i levels_of_4(const float* in) {
  const __m128 clamped = _mm_min_ps(_mm_max_ps(_mm_load_ps(in), _mm_setzero_ps()), _mm_set1_ps(1.0f));
  return _mm_cvttps_epi32(_mm_add_ps(_mm_mul_ps(clamped, _mm_set1_ps(255.0f)), _mm_set1_ps(0.5f)));
}

SG_INLINE Bytes levels(const float* in) {
  const __m128i low = _mm_packs_epi32(levels_of_4(in), levels_of_4(in + 4));
  const __m128i high = _mm_packs_epi32(levels_of_4(in + 8), levels_of_4(in + 12));
  return reinterpret_cast<Bytes>(_mm_packus_epi16(low, high));
}

SG_INLINE void bytes_body(const float* accumulators, int columns, int rows, uint8_t* pixels, int64_t stride) {
  for (int row = 0; row < rows; ++row, accumulators += 3 * kTileWidth, pixels += stride) {
    const Bytes r = levels(accumulators), g = levels(accumulators + kTileWidth), b = levels(accumulators + 2 * kTileWidth);
    const Bytes out[3] = {
        __builtin_shuffle(__builtin_shuffle(r, g, Bytes{0, 16, 0, 1, 17, 0, 2, 18, 0, 3, 19, 0, 4, 20, 0, 5}), b,
                          Bytes{0, 1, 16, 3, 4, 17, 6, 7, 18, 9, 10, 19, 12, 13, 20, 15}),
        __builtin_shuffle(__builtin_shuffle(r, g, Bytes{21, 0, 6, 22, 0, 7, 23, 0, 8, 24, 0, 9, 25, 0, 10, 26}), b,
                          Bytes{0, 21, 2, 3, 22, 5, 6, 23, 8, 9, 24, 11, 12, 25, 14, 15}),
        __builtin_shuffle(__builtin_shuffle(r, g, Bytes{0, 11, 27, 0, 12, 28, 0, 13, 29, 0, 14, 30, 0, 15, 31, 0}), b,
                          Bytes{26, 1, 2, 27, 4, 5, 28, 7, 8, 29, 10, 11, 30, 13, 14, 31})};
    if (columns == kTileWidth) std::memcpy(pixels, out, sizeof out);
    else std::memcpy(pixels, out, 3 * static_cast<size_t>(columns));
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
  attribute void bytes_##name(const float* accumulators, int columns, int rows, uint8_t* pixels, int64_t stride) { \
    bytes_body(accumulators, columns, rows, pixels, stride);                                                      \
  }                                                                                                               \
  attribute void add_##name(const Footprint& f, float floor, const Span* spans, int count, const float* color,      \
                            const Strips& picture) {                                                              \
    add_body<width>(f, floor, spans, count, color, picture);                                                      \
  }                                                                                                               \
  attribute void project_##name(const Footprint& f, float floor, const Span* spans, int count,                    \
                                const Strips& picture, float* products) {                                         \
    project_body<width>(f, floor, spans, count, picture, products);                                               \
  }                                                                                                               \
  constexpr TileKernels k_##name = {forward_##name, backward_##name, bytes_##name, add_##name, project_##name};

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
