#include "fit/pixels.h"

#include <algorithm>
#include <atomic>
#include <cmath>
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

// The squared mean errors of squares along rows of a picture, each times the sum of its pixels' visibility. What alpha
// hides has no error.
double seen_squares(const uint8_t* a, const uint8_t* b, int width, int rows, const int16_t* visibility,
                    const Seen& seen) {
  double sum = 0;
  for (int x = 0; x < width; x += kCoarseSide) {
    int errors[3] = {}, visible = 0;
    for (int row = 0; row < rows; ++row)
      for (int64_t i = int64_t{row} * width + x, end = i + std::min(kCoarseSide, width - x); i < end; ++i) {
        if (visibility[i] == 0) continue;
        for (int k = 0; k < 3; ++k) errors[k] += a[3 * i + k] - b[3 * i + k];
        visible += visibility[i];
      }
    float mean[3], weighted[3];
    for (int k = 0; k < 3; ++k)
      mean[k] = weighted[k] = static_cast<float>(errors[k]) / static_cast<float>(kCoarseSide * kCoarseSide);
    seen.weigh(weighted);
    for (int k = 0; k < 3; ++k) sum += static_cast<double>(visible) * static_cast<double>(mean[k] * weighted[k]);
  }
  return sum;
}

SG_CLONES void row_to_amplitudes(float* red, float* green, float* blue, int width, const int16_t* visibility,
                                 const float* root) {
  for (int i = 0; i < width; ++i) {
    const float seen = std::sqrt(static_cast<float>(visibility[i]) / kVisible), e0 = red[i], e1 = green[i], e2 = blue[i];
    red[i] = (root[0] * e0 + root[1] * e1 + root[2] * e2) * seen;
    green[i] = (root[3] * e0 + root[4] * e1 + root[5] * e2) * seen;
    blue[i] = (root[6] * e0 + root[7] * e1 + root[8] * e2) * seen;
  }
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
                       const Seen& seen, double coarse) {
  const int squares = (height + kCoarseSide - 1) / kCoarseSide;
  std::vector<double> sums(static_cast<size_t>(squares));  // added in order
  parallel_each(squares, std::max(kValues / (3 * kCoarseSide * width), 1), [&](int square) {
    const int y = square * kCoarseSide, rows = std::min(kCoarseSide, height - y);
    const int64_t first = int64_t{y} * width;
    double sum = 0;
    for (int64_t at = first; at < first + int64_t{rows} * width; at += width)
      sum += seen_row(a + 3 * at, b + 3 * at, width, visibility + at, seen.color, seen.luma[0], seen.luma[1],
                      seen.luma[2]);
    if (coarse > 0) sum += coarse * seen_squares(a + 3 * first, b + 3 * first, width, rows, visibility + first, seen);
    sums[static_cast<size_t>(square)] = sum;
  });
  return std::accumulate(sums.begin(), sums.end(), 0.0);
}

void to_amplitudes(float* planes, int width, int height, const int16_t* visibility, const float* root) {
  constexpr float kAlike[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1};
  const int64_t plane = int64_t{width} * height;
  parallel_each(height, std::max(kValues / (3 * width), 1), [&](int y) {
    float* const red = planes + int64_t{y} * width;
    row_to_amplitudes(red, red + plane, red + 2 * plane, width, visibility + int64_t{y} * width,
                      root == nullptr ? kAlike : root);
  });
}

}  // namespace sg
