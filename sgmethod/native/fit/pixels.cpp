#include "fit/pixels.h"

#include <algorithm>
#include <atomic>
#include <numeric>
#include <vector>

#include "core/platform.h"
#include "core/thread_pool.h"

namespace sg {
namespace {

constexpr int kValues = 1 << 16;  // of a task: their sum stays within 32 bits

SG_CLONES uint32_t sum_squares(const uint8_t* a, const uint8_t* b, int count) {
  uint32_t sum = 0;
  for (int i = 0; i < count; ++i) {
    const int e = a[i] - b[i];
    sum += static_cast<uint32_t>(e * e);
  }
  return sum;
}

SG_CLONES double seen_row(const uint8_t* a, const uint8_t* b, int width, const int16_t* visibility, float color, float l0,
                          float l1, float l2) {
  double sum = 0;
  for (int i = 0; i < width; ++i, a += 3, b += 3) {
    const auto e0 = static_cast<float>(a[0] - b[0]), e1 = static_cast<float>(a[1] - b[1]);
    const auto e2 = static_cast<float>(a[2] - b[2]);
    const float luma = l0 * e0 + l1 * e1 + l2 * e2;
    sum += static_cast<double>(visibility[i]) * (color * (e0 * e0 + e1 * e1 + e2 * e2) + luma * luma);
  }
  return sum;
}

}  // namespace

uint64_t squared_difference(const uint8_t* a, const uint8_t* b, int64_t count) {
  std::atomic<uint64_t> total{0};
  parallel_for(static_cast<int>((count + kValues - 1) / kValues), [&](int task) {
    const int64_t first = int64_t{task} * kValues;
    const int here = static_cast<int>(std::min<int64_t>(kValues, count - first));
    total.fetch_add(sum_squares(a + first, b + first, here), std::memory_order_relaxed);
  });
  return total;
}

double seen_difference(const uint8_t* a, const uint8_t* b, int width, int height, const int16_t* visibility,
                       const Seen& seen) {
  std::vector<double> sums(static_cast<size_t>(height));  // added in order
  parallel_each(height, std::max(kValues / (3 * width), 1), [&](int y) {
    const int64_t at = int64_t{y} * width;
    sums[static_cast<size_t>(y)] = seen_row(a + 3 * at, b + 3 * at, width, visibility + at, seen.color, seen.luma[0],
                                            seen.luma[1], seen.luma[2]);
  });
  return std::accumulate(sums.begin(), sums.end(), 0.0);
}

}  // namespace sg
