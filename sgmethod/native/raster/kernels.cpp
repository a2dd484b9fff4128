#include "raster/kernels.h"

#include <emmintrin.h>

#include "raster/columns.h"

namespace sg {
namespace {

// One colour's levels of 16 columns.
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
    // Red and green go to their places first, then blue between them.
    const Bytes out[3] = {
        shuffle(shuffle(r, g, Bytes{0, 16, 0, 1, 17, 0, 2, 18, 0, 3, 19, 0, 4, 20, 0, 5}), b,
                          Bytes{0, 1, 16, 3, 4, 17, 6, 7, 18, 9, 10, 19, 12, 13, 20, 15}),
        shuffle(shuffle(r, g, Bytes{21, 0, 6, 22, 0, 7, 23, 0, 8, 24, 0, 9, 25, 0, 10, 26}), b,
                          Bytes{0, 21, 2, 3, 22, 5, 6, 23, 8, 9, 24, 11, 12, 25, 14, 15}),
        shuffle(shuffle(r, g, Bytes{0, 11, 27, 0, 12, 28, 0, 13, 29, 0, 14, 30, 0, 15, 31, 0}), b,
                          Bytes{26, 1, 2, 27, 4, 5, 28, 7, 8, 29, 10, 11, 30, 13, 14, 31})};
    if (columns == kTileWidth) std::memcpy(pixels, out, sizeof out);
    else std::memcpy(pixels, out, 3 * static_cast<size_t>(columns));
  }
}

#define SG_KERNELS(name, width, attribute)                                                                        \
  attribute void forward_##name(const Rasterization& r, int tile, const float* colors, float* accumulators) {     \
    for_batches<width>(r, tile, [&](const Batch& batch) SG_INLINE_LAMBDA {                                        \
      forward_body<width>(r, batch, colors, accumulators);                                                        \
    });                                                                                                           \
  }                                                                                                               \
  attribute void bytes_##name(const float* accumulators, int columns, int rows, uint8_t* pixels, int64_t stride) { \
    bytes_body(accumulators, columns, rows, pixels, stride);                                                      \
  }                                                                                                               \
  constexpr TileKernels k_##name = {forward_##name, bytes_##name};

SG_KERNELS(baseline, 4, )
SG_KERNELS(avx2, 8, [[gnu::target("avx2")]])
SG_KERNELS(avx512, 16, [[gnu::target(SG_AVX512)]])

}  // namespace

const TileKernels& kernels(int isa) {
  static const TileKernels* const table[] = {&k_baseline, &k_avx2, &k_avx512};
  return *table[isa];
}

}  // namespace sg
