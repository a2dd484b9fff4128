#include "raster/kernels.h"

#include "raster/columns.h"

namespace sg {
namespace {

// Levels of one colour in 16 columns.
typedef uint8_t Bytes __attribute__((vector_size(16)));

// Levels fit the lowest byte of each integer: take the lower half, and the lower half of that.
SG_INLINE Bytes levels(const float* in) {
  using V = Simd<4>;
  typedef int16_t Shorts __attribute__((vector_size(16)));
  const auto four = [&](int i) SG_INLINE_LAMBDA {
    const V::F clamped = V::min(V::max0(V::load(in + 4 * i)), V::all(1.0f));
    return reinterpret_cast<Shorts>(__builtin_convertvector(clamped * 255.0f + 0.5f, V::I));
  };
  const auto eight = [&](int i) SG_INLINE_LAMBDA {
    return reinterpret_cast<Bytes>(shuffle(four(i), four(i + 1), Shorts{0, 2, 4, 6, 8, 10, 12, 14}));
  };
  return shuffle(eight(0), eight(2), Bytes{0, 2, 4, 6, 8, 10, 12, 14, 16, 18, 20, 22, 24, 26, 28, 30});
}

// Writes bytes for the baseline, which has no byte shuffle on x86-64.
SG_INLINE void packed_bytes(const float* accumulators, int columns, int rows, uint8_t* pixels, int64_t stride) {
  for (int row = 0; row < rows; ++row, accumulators += 3 * kTileWidth, pixels += stride) {
    const Bytes r = levels(accumulators), g = levels(accumulators + kTileWidth);
    const Bytes b = levels(accumulators + 2 * kTileWidth);
    // Red and green go to their places first, then blue between them.
    const Bytes out[3] = {shuffle(shuffle(r, g, Bytes{0, 16, 0, 1, 17, 0, 2, 18, 0, 3, 19, 0, 4, 20, 0, 5}), b,
                                  Bytes{0, 1, 16, 3, 4, 17, 6, 7, 18, 9, 10, 19, 12, 13, 20, 15}),
                          shuffle(shuffle(r, g, Bytes{21, 0, 6, 22, 0, 7, 23, 0, 8, 24, 0, 9, 25, 0, 10, 26}), b,
                                  Bytes{0, 21, 2, 3, 22, 5, 6, 23, 8, 9, 24, 11, 12, 25, 14, 15}),
                          shuffle(shuffle(r, g, Bytes{0, 11, 27, 0, 12, 28, 0, 13, 29, 0, 14, 30, 0, 15, 31, 0}), b,
                                  Bytes{26, 1, 2, 27, 4, 5, 28, 7, 8, 29, 10, 11, 30, 13, 14, 31})};
    if (columns == kTileWidth) std::memcpy(pixels, out, sizeof out);
    else std::memcpy(pixels, out, 3 * static_cast<size_t>(columns));
  }
}

// Writes bytes where byte shuffles are fast: the processor clamps as it narrows, and then colours are interleaved. NaN
// becomes black in both versions.
[[maybe_unused]] SG_INLINE void shuffled_bytes(const float* accumulators, int columns, int rows, uint8_t* pixels,
                                               int64_t stride) {
  using V = Simd<8>;
  typedef uint8_t Bytes32 __attribute__((vector_size(32)));
  constexpr Bytes32 kMixed = {0,  4,  8,  1,  5,  9,  2,  6,  10, 3,  7,  11, 12, 12, 12, 12,
                              16, 20, 24, 17, 21, 25, 18, 22, 26, 19, 23, 27, 28, 28, 28, 28};
  constexpr V::I kTogether = {0, 1, 2, 4, 5, 6, 3, 3};
  const auto eight = [&](int row, int lane) SG_INLINE_LAMBDA {  // pixels, in 24 bytes
    const auto level = [&](int k) SG_INLINE_LAMBDA {
      const float* values = accumulators + (3 * row + k) * kTileWidth + lane;
      return __builtin_convertvector(V::min(V::all(1.0f), V::load(values)) * 255.0f + 0.5f, V::I);
    };
    const auto whole = V::bytes(level(0), level(1), level(2));
    const auto mixed = reinterpret_cast<V::I>(shuffle(whole, whole, kMixed));
    return shuffle(mixed, mixed, kTogether);
  };
  for (int row = 0; row < rows; ++row, pixels += stride) {
    const V::I left = eight(row, 0), right = eight(row, 8);
    if (columns == kTileWidth) {  // no store reaches beyond the row
      std::memcpy(pixels, &left, 32);
      std::memcpy(pixels + 24, &right, 16);
      std::memcpy(pixels + 40, reinterpret_cast<const uint8_t*>(&right) + 16, 8);
    } else {
      uint8_t out[24 + 32];
      std::memcpy(out, &left, 32);
      std::memcpy(out + 24, &right, 32);
      std::memcpy(pixels, out, 3 * static_cast<size_t>(columns));
    }
  }
}

template <int W>
SG_INLINE void forward_body(const Rasterization& raster, int tile, const Pair* begin, const Pair* end,
                            const float* colors, float* accumulators) {
  for_batches<W>(raster, tile, begin, end,
                 [&](const Batch& batch) SG_INLINE_LAMBDA { add_batch<W>(raster, batch, colors, accumulators); });
}

template <int W>
SG_INLINE void bytes_body(const float* accumulators, int columns, int rows, uint8_t* pixels, int64_t stride) {
  if constexpr (W == 4) packed_bytes(accumulators, columns, rows, pixels, stride);
  else shuffled_bytes(accumulators, columns, rows, pixels, stride);
}

// Along an axis, sample 2u of the result is (3 c[u + 1] + c[u]) / 4 and sample 2u + 1 is (3 c[u + 1] + c[u + 2]) / 4,
// with c the coarse samples: first along x, then along y. c is already divided by 16, which is exact.
template <int W>
SG_INLINE void enlarge_body(const float* coarse, int64_t stride, int rows, const float* background,
                            float* accumulators) {
  using V = Simd<W>;
  using F = typename V::F;
  // AVX2 shuffles faster within halves than across them, so the upper half is loaded separately.
  typename V::I near_places, far_places;
  for (int i = 0; i < W; ++i) {
    const int moved = W == 8 ? i / 4 * 2 : 0;
    near_places[i] = moved + 1 + i / 2, far_places[i] = moved + (i % 2 == 0 ? i / 2 : i / 2 + 2);
  }
  const auto samples = [](const float* p) SG_INLINE_LAMBDA {
    if constexpr (W == 8) return V::halves(p, p + 2);
    else return V::load(p);
  };
  constexpr int kVectors = kTileWidth / W;
  // One colour after the other, so that three of its rows stay in registers.
  for (int k = 0; k < 3; ++k, coarse += stride, accumulators += kTileWidth) {
    const auto along_x = [&](int row, F* out) SG_INLINE_LAMBDA {
      for (int i = 0; i < kVectors; ++i) {
        const float* const from = coarse + 3 * row * stride + i * W / 2;
        if (i == 0) __builtin_prefetch(from + kTileWidth);  // of the next tile
        const F in = samples(from);
        out[i] = shuffle(in, in, near_places) * 3.0f + shuffle(in, in, far_places);
      }
    };
    const float under = background[k];
    F above[kVectors], near[kVectors], below[kVectors];
    along_x(0, above);
    along_x(1, near);
    float* out = accumulators;
    for (int row = 0; row < rows; row += 2, out += 6 * kTileWidth) {
      along_x(row / 2 + 2, below);
      for (int i = 0; i < kVectors; ++i) {
        const F thrice = near[i] * 3.0f;
        V::store(out + i * W, (thrice + above[i]) + under);
        V::store(out + 3 * kTileWidth + i * W, (thrice + below[i]) + under);
        above[i] = near[i];
        near[i] = below[i];
      }
    }
  }
}

template <int W>
SG_INLINE void sixteenth_body(const float* accumulators, int columns, int rows, float* samples, int64_t stride) {
  using V = Simd<W>;
  constexpr float kShare = 1.0f / 16.0f;
  for (const float* end = accumulators + rows * 3 * kTileWidth; accumulators != end;
       accumulators += kTileWidth, samples += stride)
    if (columns == kTileWidth) {
      __builtin_prefetch(samples + 2 * kTileWidth, 1);
      for (int i = 0; i < kTileWidth; i += W) V::store(samples + i, V::load(accumulators + i) * kShare);
    } else {
      for (int i = 0; i < columns; ++i) samples[i] = accumulators[i] * kShare;
    }
}

#define SG_KERNELS(wrapper, W)                                                                \
  {wrapper<cross_strips<std::min(W, 8)>>, wrapper<forward_body<W>>, wrapper<enlarge_body<W>>, \
   wrapper<sixteenth_body<W>>, wrapper<bytes_body<W>>}
constexpr TileKernels kKernels[] = {
    SG_KERNELS(for_baseline, 4),
#if SG_X86
    SG_KERNELS(for_avx2, 8),
    SG_KERNELS(for_avx512, 16),
#endif
};

}  // namespace

const TileKernels& kernels(int isa) { return kKernels[isa]; }

}  // namespace sg
