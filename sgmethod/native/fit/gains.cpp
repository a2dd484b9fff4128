#include "fit/gains.h"

#include <algorithm>
#include <cmath>
#include <cstring>

#include "core/isa.h"
#include "core/simd.h"
#include "core/thread_pool.h"

namespace sg {
namespace {

constexpr int kRows = 16;      // of a task
constexpr int kColumns = 512;  // blurred together: the rows around them stay in the cache
constexpr int kTogether = 4;   // vectors summed together

struct Residual {
  const float* planes[3];
  int width, height;
};

// Row or column -1 is 1, and one beyond the last is the last but one.
int mirrored(int place, int count) {
  if (count == 1) return 0;
  while (place < 0 || place >= count) place = place < 0 ? -place : 2 * (count - 1) - place;
  return place;
}

// Calls take(x, sums) for all x in [0, count), several at a time, with the sums over k of the blur's weight times
// at(k)[x].
template <int W, typename At, typename Take>
SG_INLINE void weighted(const Blur& blur, int count, const At& at, const Take& take) {
  using V = Simd<W>;
  const int radius = blur.radius();
  const float* const weights = blur.kernel.data();
  int x = 0;
  for (; x + kTogether * W <= count; x += kTogether * W) {
    typename V::F sums[kTogether];
    for (int i = 0; i < kTogether; ++i) sums[i] = V::load(at(0) + x + i * W) * weights[0];
    for (int k = 1; k <= radius; ++k) {
      const float *before = at(-k) + x, *after = at(k) + x;
      for (int i = 0; i < kTogether; ++i) sums[i] += (V::load(before + i * W) + V::load(after + i * W)) * weights[k];
    }
    for (int i = 0; i < kTogether; ++i) take(x + i * W, sums[i]);
  }
  for (; x < count; ++x) {
    float sum = at(0)[x] * weights[0];
    for (int k = 1; k <= radius; ++k) sum += (at(-k)[x] + at(k)[x]) * weights[k];
    take(x, sum);
  }
}

// Some columns of a row: memory for its blurred values, and for their squares' sums over the planes.
class Part {
 public:
  Part(const Residual& residual, const std::vector<Blur>& blurs) : residual_(residual), squares_(kColumns) {
    int radius = 0;
    for (const Blur& blur : blurs) radius = std::max(radius, blur.radius());
    rows_.resize(2 * static_cast<size_t>(radius) + 1);
    line_.resize(kColumns + 2 * static_cast<size_t>(radius));
  }

  // Squares of columns [first, first + count): first down the columns, then along them.
  template <int W>
  SG_INLINE const float* squares(const Blur& blur, int row, int first, int count) {
    const int radius = blur.radius(), begin = std::max(first - radius, 0);
    const int end = std::min(first + count + radius, residual_.width);
    float* const line = line_.data() + radius;  // of column `first`
    float* const squares = squares_.data();
    std::fill_n(squares, count, 0.0f);
    for (const float* plane : residual_.planes) {
      for (int k = -radius; k <= radius; ++k)
        rows_[radius + k] = plane + int64_t{mirrored(row + k, residual_.height)} * residual_.width + begin;
      const float* const* const rows = rows_.data() + radius;
      float* const blurred = line + begin - first;
      weighted<W>(blur, end - begin, [&](int k) SG_INLINE_LAMBDA { return rows[k]; },
                  [&](int x, const auto& sums) SG_INLINE_LAMBDA { std::memcpy(blurred + x, &sums, sizeof sums); });
      for (int x = first - radius; x < begin; ++x) line[x - first] = line[mirrored(x, residual_.width) - first];
      for (int x = end; x < first + count + radius; ++x) line[x - first] = line[mirrored(x, residual_.width) - first];
      weighted<W>(blur, count, [&](int k) SG_INLINE_LAMBDA { return line + k; },
                  [&](int x, const auto& sums) SG_INLINE_LAMBDA {
                    auto all = sums;
                    std::memcpy(&all, squares + x, sizeof all);
                    all += sums * sums;
                    std::memcpy(squares + x, &all, sizeof all);
                  });
    }
    return squares;
  }

 private:
  const Residual& residual_;
  std::vector<const float*> rows_;
  std::vector<float> line_, squares_;
};

template <int W>
SG_INLINE void gains_body(const Residual& residual, const std::vector<Blur>& blurs, int begin, int end, float* gain,
                          uint8_t* chosen) {
  Part part(residual, blurs);
  for (int first = 0; first < residual.width; first += kColumns)
    for (int row = begin; row < end; ++row) {
      const int count = std::min(kColumns, residual.width - first);
      float* const largest = gain + int64_t{row} * residual.width + first;
      uint8_t* const which = chosen + int64_t{row} * residual.width + first;
      std::fill_n(largest, count, -1.0f);
      std::fill_n(which, count, uint8_t{0});  // where no gain is a number
      for (size_t b = 0; b < blurs.size(); ++b) {
        const float* const squares = part.squares<W>(blurs[b], row, first, count);
        const float scale = blurs[b].scale;
        for (int x = 0; x < count; ++x) {
          const float own = squares[x] * scale;
          which[x] = own > largest[x] ? static_cast<uint8_t>(b) : which[x];
          largest[x] = std::max(largest[x], own);
        }
      }
    }
}

using Body = void (*)(const Residual&, const std::vector<Blur>&, int begin, int end, float* gain, uint8_t* chosen);
constexpr Body kBodies[] = {
    for_baseline<gains_body<4>>,
#if SG_X86
    for_avx2<gains_body<8>>,
    for_avx512<gains_body<16>>,
#endif
};

}  // namespace

Blur::Blur(float sigma, float scale) : scale(scale), kernel(static_cast<size_t>(std::lround(4 * sigma)) + 1) {
  const auto weight = [&](size_t k) { return std::exp(-0.5 * static_cast<double>(k * k) / (double{sigma} * sigma)); };
  double sum = 1;
  for (size_t k = 1; k < kernel.size(); ++k) sum += 2 * weight(k);
  for (size_t k = 0; k < kernel.size(); ++k) kernel[k] = static_cast<float>(weight(k) / sum);
}

void gains(const float* const (&planes)[3], int width, int height, const std::vector<Blur>& blurs, int isa, float* gain,
           uint8_t* chosen) {
  const Residual residual{{planes[0], planes[1], planes[2]}, width, height};
  parallel_chunks(height, kRows,
                  [&](int begin, int end, int) { kBodies[isa](residual, blurs, begin, end, gain, chosen); });
}

}  // namespace sg
