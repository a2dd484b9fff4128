// Kernels for fitting only. They do not affect decoded pixels, so a multiplication and an addition may be fused
// (CMakeLists.txt).
#include <algorithm>

#include "fit/fit_kernels.h"
#include "raster/columns.h"

namespace sg {
namespace {

template <int W>
SG_INLINE typename Simd<W>::F load_target(const int16_t* in) {
  typename Lanes<W>::S values;
  std::memcpy(&values, in, sizeof values);
  // In two steps, by integers as wide as floats: GCC uses more instructions for a direct conversion.
  return __builtin_convertvector(__builtin_convertvector(values, typename Simd<W>::I), typename Simd<W>::F);
}

// Replaces the tile's picture by the gradient of the squared error, and returns the squared error.
template <int W>
SG_INLINE double difference_body(float* values, const TileTarget& target) {
  using V = Simd<W>;
  constexpr float kStep = 1.0f / kTargetWhite;
  constexpr int kVectors = kTileWidth / W;
  const TileTarget t = target;  // a copy, so that the compiler knows that no store changes it
  typename V::F sums[3 * kVectors] = {};  // several, so that additions need not wait for each other
  for (int row = 0; row < t.rows; ++row, values += 3 * kTileWidth)
    for (int k = 0; k < 3; ++k) {
      const int16_t* wanted = t.first + k * t.plane + row * t.stride;
      float* here = values + k * kTileWidth;
      __builtin_prefetch(wanted + t.ahead);
      if (t.columns == kTileWidth) {
        for (int i = 0; i < kVectors; ++i) {
          const typename V::F difference = V::load(here + i * W) - load_target<W>(wanted + i * W) * kStep;
          sums[k * kVectors + i] += difference * difference;
          V::store(here + i * W, difference * t.scale);
        }
      } else {
        for (int column = 0; column < t.columns; ++column) {
          const float difference = here[column] - static_cast<float>(wanted[column]) * kStep;
          sums[0][0] += difference * difference;
          here[column] = difference * t.scale;
        }
        std::fill(here + t.columns, here + kTileWidth, 0.0f);
      }
    }
  std::fill(values, values + (kTileHeight - t.rows) * 3 * kTileWidth, 0.0f);
  typename V::F sum{};
  for (const typename V::F& part : sums) sum += part;
  return V::sum(sum);
}

// In each lane, the sum over its aligned group of 1, 2 or 4 lanes.
template <int W, int kSide>
SG_INLINE typename Simd<W>::F sum_groups(typename Simd<W>::F v) {
  typename Simd<W>::I lanes;
  for (int i = 0; i < W; ++i) lanes[i] = i;
  if constexpr (kSide >= 2) v += shuffle(v, v, lanes ^ 1);
  if constexpr (kSide == 4) v += shuffle(v, v, lanes ^ 2);
  return v;
}

// The same for the error weighted by visibility, in which mean errors of squares of kSide pixels count once more. With
// m the mean of pixel i's square, the gradient by that pixel is V_i (e_i + weight m): visibility hardly changes within
// it. What alpha hides has no part in m.
template <int W, int kSide>
SG_INLINE double squares_body(float* values, const TileTarget& target) {
  using V = Simd<W>;
  using F = typename V::F;
  constexpr float kStep = 1.0f / kTargetWhite, kUnit = 1.0f / kVisible;
  const TileTarget t = target;
  const float y0 = t.seen.luma[0], y1 = t.seen.luma[1], y2 = t.seen.luma[2], color = t.seen.color;
  const float of_sum = t.coarse.weight / (kSide * kSide);
  F sum{};
  int16_t part[kSide][4][kTileWidth] = {};  // rows at the picture's right edge, beyond which nothing is visible
  const int16_t beyond[kTileWidth] = {};    // a row below the picture
  for (int square = 0; square < t.rows; square += kSide) {
    const int16_t* in[kSide][4];
    float* const first = values + 3 * square * kTileWidth;
    for (int row = 0; row < kSide; ++row) {
      const bool inside = square + row < t.rows;
      const int16_t* const here = t.first + (square + row) * t.stride;
      const int16_t* const rows[4] = {here, here + t.plane, here + 2 * t.plane,
                                      t.visibility + (square + row) * t.stride};
      for (int k = 0; k < 4; ++k) {
        in[row][k] = inside ? rows[k] : beyond;
        if (inside) __builtin_prefetch(rows[k] + t.ahead);
        if (inside && t.columns != kTileWidth) {
          std::copy_n(rows[k], t.columns, part[row][k]);
          in[row][k] = part[row][k];
        }
        if (k < 3 && !(inside && t.columns == kTileWidth)) {
          float* const drawn = first + (3 * row + k) * kTileWidth;
          std::fill(drawn + (inside ? t.columns : 0), drawn + kTileWidth, 0.0f);
        }
      }
    }
    for (int i = 0; i < kTileWidth; i += W) {
      F e[kSide][3], coarse[3] = {};
      for (int row = 0; row < kSide; ++row) {
        const F seen = load_target<W>(in[row][3] + i);
        for (int k = 0; k < 3; ++k) {
          const F error = V::load(first + (3 * row + k) * kTileWidth + i) - load_target<W>(in[row][k] + i) * kStep;
          e[row][k] = seen > 0 ? error : F{};
          coarse[k] += e[row][k];
        }
      }
      for (F& mean : coarse) mean = sum_groups<W, kSide>(mean) * of_sum;
      for (int row = 0; row < kSide; ++row) {
        const F e0 = e[row][0], e1 = e[row][1], e2 = e[row][2];
        const F c0 = e0 + coarse[0], c1 = e1 + coarse[1], c2 = e2 + coarse[2];
        const F seen = load_target<W>(in[row][3] + i) * kUnit, own = seen * color;
        const F of_luma = seen * (c0 * y0 + c1 * y1 + c2 * y2);
        sum += own * (e0 * c0 + e1 * c1 + e2 * c2) + of_luma * (e0 * y0 + e1 * y1 + e2 * y2);
        float* const here = first + 3 * row * kTileWidth + i;
        V::store(here, (own * c0 + of_luma * y0) * t.scale);
        V::store(here + kTileWidth, (own * c1 + of_luma * y1) * t.scale);
        V::store(here + 2 * kTileWidth, (own * c2 + of_luma * y2) * t.scale);
      }
    }
  }
  const int done = (t.rows + kSide - 1) / kSide * kSide;
  std::fill(values + done * 3 * kTileWidth, values + kTileFloats, 0.0f);
  return V::sum(sum);
}

template <int W>
SG_INLINE double seen_difference_body(float* values, const TileTarget& target) {
  if (target.coarse.weight == 0 || target.coarse.side == 1) return squares_body<W, 1>(values, target);
  return target.coarse.side == 2 ? squares_body<W, 2>(values, target) : squares_body<W, 4>(values, target);
}

SG_INLINE void weigh_body(float* values, const int16_t* visibility, int64_t stride, int columns, int rows) {
  constexpr float kUnit = 1.0f / kVisible;
  for (int row = 0; row < rows; ++row, visibility += stride)
    for (int k = 0; k < 3; ++k, values += kTileWidth)
      for (int column = 0; column < columns; ++column) values[column] *= static_cast<float>(visibility[column]) * kUnit;
}

// Inside the ellipse the weight's derivative by sigma is -e. With g = (dL/dweight) e there, dL/dsigma = -g, and all
// gradients of the geometry follow from five moments: the sums of g z1, g z2, g z1^2, g z1 z2 and g z2^2.
//
// z1 is constant down a lane, so the loop over rows needs only the sums of g, g z2 and g z2^2. It computes them without
// a multiplication by z2: in a segment, d rows before its last row, z2 = last - d / l3. The sums of g d and of g d (d -
// 1) / 2 are running sums of running sums, and z2 is substituted after the loop. Little precision is lost, because z2
// changes by at most 9 within a segment.
template <int W>
SG_INLINE void backward_batch(const Rasterization& raster, int tile, const Batch& batch, const float* colors,
                              const float* tile_gradient, float* pair_gradients) {
  using V = Simd<W>;
  using F = typename V::F;
  const int x0 = raster.tile_x(tile), y0 = raster.tile_y(tile);
  const float floor = raster.floor();
  const float* first = batch.first;
  for (const Pair* pair = batch.begin; pair != batch.end; ++pair) {
    const Footprint& f = raster.footprint(pair->gaussian);
    const float* color = colors + 3 * static_cast<int64_t>(pair->gaussian);
    const float c0 = color[0] * f.gain, c1 = color[1] * f.gain, c2 = color[2] * f.gain;
    F d0{}, d1{}, d2{}, m1{}, m2{}, m11{}, m12{}, m22{};
    for (int lane = lanes_begin<W>(*pair); lane < lanes_end<W>(*pair); lane += W) {
      const F dx = lane_centres<W>(static_cast<float>(x0 + lane)) - f.x;
      const F z1 = dx * f.inv_l1;
      F g0{}, g2{}, g22{};
      for (int row = pair->first_row; row <= pair->last_row;) {
        const int end = segment_end(f, row, pair->last_row);
        Column<W> c = next_column<W>(first);
        F sum{}, sum_d{}, sum_pairs_d{};
        const float* in = tile_gradient + row * (3 * kTileWidth) + lane;
        for (; row < end; ++row, in += 3 * kTileWidth) {
          const F i0 = V::load(in), i1 = V::load(in + kTileWidth), i2 = V::load(in + 2 * kTileWidth);
          const F weight = V::max0(c.e - floor);
          d0 += weight * i0;
          d1 += weight * i1;
          d2 += weight * i2;
          const F slope = (i0 * c0 + i1 * c1 + i2 * c2) * c.e;
          sum_pairs_d += sum_d;
          sum_d += sum;
          sum += c.e > floor ? slope : F{};
          c.e *= c.ratio;
          c.ratio *= f.decay;
        }
        const F last = (static_cast<float>(y0 + end - 1) + 0.5f - f.y - dx * f.shear) * f.inv_l3;
        const F by_d = sum_d * f.inv_l3, by_d_square = (2.0f * sum_pairs_d + sum_d) * (f.inv_l3 * f.inv_l3);
        const F by_z2 = last * sum - by_d;
        g0 += sum;
        g2 += by_z2;
        g22 += last * (by_z2 - by_d) + by_d_square;
      }
      m1 += g0 * z1;
      m2 += g2;
      m11 += g0 * z1 * z1;
      m12 += g2 * z1;
      m22 += g22;
    }
    const F moments[8] = {m1, m2, m11, m12, m22, d0, d1, d2};
    float s[8];
    V::sums(moments, s);
    pair_gradients[0] = s[0] * f.inv_l1 - s[1] * f.shear * f.inv_l3;
    pair_gradients[1] = s[1] * f.inv_l3;
    pair_gradients[2] = s[2] * f.inv_l1 - s[3] * f.shear * f.inv_l3;
    pair_gradients[3] = s[3] * f.inv_l3;
    pair_gradients[4] = s[4] * f.inv_l3;
    std::copy_n(s + 5, 3, pair_gradients + 5);
    pair_gradients += kPairGradients;
  }
}

template <int W>
SG_INLINE void backward_body(const Rasterization& raster, int tile, const float* colors, const float* tile_gradient,
                             float* pair_gradients) {
  const auto draw = [&](const Batch& batch) SG_INLINE_LAMBDA {
    backward_batch<W>(raster, tile, batch, colors, tile_gradient, pair_gradients);
    pair_gradients += (batch.end - batch.begin) * kPairGradients;
  };
  for_batches<W>(raster, tile, raster.tile_begin(tile), raster.tile_end(tile), draw);
}

template <int W>
SG_INLINE double squared_error_body(const Rasterization& raster, int tile, const float* colors,
                                    const TileTarget& target, float* first, float* values, float* pair_gradients) {
  first_values<W>(raster, tile, raster.tile_begin(tile), raster.tile_end(tile), first);
  const Batch all{raster.tile_begin(tile), raster.tile_end(tile), first};
  add_batch<W>(raster, all, colors, values);
  const double error =
      target.visibility == nullptr ? difference_body<W>(values, target) : seen_difference_body<W>(values, target);
  backward_batch<W>(raster, tile, all, colors, values, pair_gradients);
  return error;
}

// Transpose of enlarging, for a tile [kTileHeight][3][kTileWidth]: along y, then along x. Along an axis, sample w of
// the result is (t[2w - 3] + 3 t[2w - 2] + 3 t[2w - 1] + t[2w]) / 4, with t the tile's samples.
SG_INLINE void reduce_body(const float* gradient, int rows, float* to, float* aside, int64_t stride) {
  constexpr int W = kTileWidth / 2;
  using V = Simd<W>;
  using F = V::F;
  constexpr V::I kEven = {0, 2, 4, 6, 8, 10, 12, 14}, kOdd = {1, 3, 5, 7, 9, 11, 13, 15};
  constexpr V::I kTurned = {7, 0, 1, 2, 3, 4, 5, 6}, kFirst = {-1};
  const auto reduced_row = [&](int w, float* out) SG_INLINE_LAMBDA {
    for (int k = 0; k < 3; ++k, out += stride) {
      __builtin_prefetch(out + 2 * W + 2, 1);
      F half[2];
      for (int i = 0; i < 2; ++i) {
        const auto row_of = [&](int t)
                                SG_INLINE_LAMBDA { return V::load(gradient + (3 * t + k) * kTileWidth + i * W); };
        half[i] = (row_of(2 * w - 3) + row_of(2 * w)) * 0.25f + (row_of(2 * w - 2) + row_of(2 * w - 1)) * 0.75f;
      }
      // Shifted by one sample: the first lane of a rotated vector belongs to the next one.
      const F even = shuffle(half[0], half[1], kEven) * 0.25f, odd = shuffle(half[0], half[1], kOdd) * 0.25f;
      const F odd_turned = shuffle(odd, odd, kTurned);
      const F other = (even + odd) * 3.0f + (kFirst ? F{} : odd_turned), other_turned = shuffle(other, other, kTurned);
      V::store(out, V::load(out) + (even + (kFirst ? F{} : other_turned)));
      out[W] += other_turned[0];
      out[W + 1] += odd_turned[0];
    }
  };
  for (int w = 0; w < std::min(rows, kReducedRows - kOverRows); ++w) reduced_row(w, to + w * 3 * stride);
  for (int w = 0; w < kOverRows; ++w) reduced_row(kReducedRows - kOverRows + w, aside + w * 3 * stride);
}

// Calls visit(weights, pointer to the picture's values, index of the pixel in all strips) for each row and vector of
// lanes that a Gaussian touches.
template <int W, typename Visit>
SG_INLINE void for_weights(const Footprint& f, float floor, const Span* spans, int count, const Strips& picture,
                           const Visit& visit) {
  using V = Simd<W>;
  for (const Span* span = spans; span != spans + count; ++span) {
    const int x0 = span->strip * kTileWidth;
    for (int lane = 0; lane < kTileWidth; lane += W) {
      const typename V::F centres = lane_centres<W>(static_cast<float>(x0 + lane));
      const typename V::F inside = centres < static_cast<float>(picture.width) ? V::all(1.0f) : typename V::F{};
      for (int row = span->first_row; row <= span->last_row;) {
        const int end = segment_end(f, row, span->last_row);
        Column<W> c = column<W>({&f, static_cast<float>(x0 + lane), static_cast<float>(row)});
        float* values = picture.row(span->strip, row) + lane;
        for (; row < end; ++row, values += 3 * kTileWidth) {
          const int64_t at = (static_cast<int64_t>(span->strip) * picture.height + row) * kTileWidth + lane;
          visit(V::max0(c.e - floor) * inside, values, at);
          c.e *= c.ratio;
          c.ratio *= f.decay;
        }
      }
    }
  }
}

template <int W>
SG_INLINE void weights_body(const Footprint& f, float floor, const Span* spans, int count, int first_row,
                            int64_t stride, float* patch) {
  using V = Simd<W>;
  for (const Span* span = spans; span != spans + count; ++span)
    for (int lane = 0; lane < kTileWidth; lane += W) {
      const auto x = static_cast<float>(span->strip * kTileWidth + lane);
      float* out = patch + (span->first_row - first_row) * stride + (span->strip - spans->strip) * kTileWidth + lane;
      for (int row = span->first_row; row <= span->last_row;) {
        const int end = segment_end(f, row, span->last_row);
        Column<W> c = column<W>({&f, x, static_cast<float>(row)});
        for (; row < end; ++row, out += stride) {
          V::store(out, V::max0(c.e - floor));
          c.e *= c.ratio;
          c.ratio *= f.decay;
        }
      }
    }
}

template <int W>
SG_INLINE void add_body(const Footprint& f, float floor, const Span* spans, int count, const float* color,
                        const Strips& picture) {
  using V = Simd<W>;
  const float c0 = color[0], c1 = color[1], c2 = color[2];
  for_weights<W>(f, floor, spans, count, picture, [&](typename V::F weight, float* values, int64_t) SG_INLINE_LAMBDA {
    V::store(values, V::load(values) + weight * c0);
    V::store(values + kTileWidth, V::load(values + kTileWidth) + weight * c1);
    V::store(values + 2 * kTileWidth, V::load(values + 2 * kTileWidth) + weight * c2);
  });
}

template <int W>
SG_INLINE void project_body(const Footprint& f, float floor, const Span* spans, int count, const Strips& picture,
                            const int16_t* visibility, float* products) {
  constexpr float kUnit = 1.0f / kVisible;
  using V = Simd<W>;
  typename V::F p0{}, p1{}, p2{}, square{};
  const auto add = [&](typename V::F weight, typename V::F seen, float* values) SG_INLINE_LAMBDA {
    p0 += seen * V::load(values);
    p1 += seen * V::load(values + kTileWidth);
    p2 += seen * V::load(values + 2 * kTileWidth);
    square += seen * weight;
  };
  if (visibility == nullptr)
    for_weights<W>(f, floor, spans, count, picture,
                   [&](typename V::F weight, float* values, int64_t) SG_INLINE_LAMBDA { add(weight, weight, values); });
  else
    for_weights<W>(f, floor, spans, count, picture,
                   [&](typename V::F weight, float* values, int64_t at)
                       SG_INLINE_LAMBDA { add(weight, weight * (load_target<W>(visibility + at) * kUnit), values); });
  products[0] = V::sum(p0);
  products[1] = V::sum(p1);
  products[2] = V::sum(p2);
  products[3] = V::sum(square);
}

#define SG_FIT_KERNELS(wrapper, W)                                                                               \
  {wrapper<squared_error_body<W>>, wrapper<difference_body<W>>, wrapper<weigh_body>,  wrapper<backward_body<W>>, \
   wrapper<reduce_body>,           wrapper<weights_body<W>>,    wrapper<add_body<W>>, wrapper<project_body<W>>}
constexpr FitKernels kKernels[] = {
    SG_FIT_KERNELS(for_baseline, 4),
#if SG_X86
    SG_FIT_KERNELS(for_avx2, 8),
    SG_FIT_KERNELS(for_avx512, 16),
#endif
};

}  // namespace

int64_t first_value_count(const Rasterization& raster, int tile) {
  int64_t count = 0;
  for (const Pair *pair = raster.tile_begin(tile), *end = raster.tile_end(tile); pair != end; ++pair)
    count += segments(raster, *pair);
  return count * 2 * kTileWidth;
}

const FitKernels& fit_kernels(int isa) { return kKernels[isa]; }

}  // namespace sg
