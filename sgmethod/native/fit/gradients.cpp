// Backpropagation, in the opposite order of drawing (raster/drawing.cpp): the gradient by a level's picture is that by
// the finer level's, reduced.
#include "fit/gradients.h"

#include <algorithm>
#include <cstring>
#include <memory>
#include <numeric>
#include <stdexcept>
#include <vector>

#include "core/errors.h"
#include "core/platform.h"
#include "core/scratch.h"
#include "fit/reduction.h"
#include "raster/levels.h"

namespace sg {
namespace {

// Rows of a large picture lie too far apart for the processor to prefetch them, so each kernel prefetches those of the
// next tile.
constexpr int kAhead = 2 * kTileWidth - 1;

// Converts gradients, in place, from those by a Gaussian's mean [2], factor [3] and gain in samples of its coarse level
// to those by its mean and factor in pixels.
//
// With a = p1^2, b = p1 p2, c = p2^2 + p3^2: q1 = sqrt(a - v), q2 = b / q1, q3 = sqrt(c - v - q2^2), and the gain is p1
// p3 / (q1 q3). Here d_x is the gradient by x.
void to_pixels(const float* factor, int level, float by_gain, float* by_mean, float* by_factor) {
  const double scale = power_of_two(-level);
  const auto [p1, p2, p3, q1, q2, q3] = Narrowed(factor, level);
  const double d_log_gain = by_gain * (p1 * p3 / (q1 * q3));
  const double d_q3 = by_factor[2] - d_log_gain / q3;
  const double d_c = d_q3 / (2 * q3), d_q2 = by_factor[1] - d_q3 * q2 / q3, d_b = d_q2 / q1;
  const double d_q1 = by_factor[0] - d_log_gain / q1 - d_q2 * q2 / q1, d_a = d_q1 / (2 * q1);
  by_mean[0] = static_cast<float>(by_mean[0] * scale);
  by_mean[1] = static_cast<float>(by_mean[1] * scale);
  by_factor[0] = static_cast<float>((2 * d_a * p1 + d_b * p2 + d_log_gain / p1) * scale);
  by_factor[1] = static_cast<float>((d_b * p1 + 2 * d_c * p2) * scale);
  by_factor[2] = static_cast<float>((2 * d_c * p3 + d_log_gain / p3) * scale);
}

// Sums in the order of each Gaussian's pairs, so that the result is the same for every number of threads.
void sum_pairs(const Rasterization& raster, const float* colors, const float* pair_gradients,
               const MutableGaussians& out) {
  raster.for_places([&](int64_t i, const int32_t* place, const int32_t* end) {
    float sum[kPairGradients] = {};
    for (; place < end; ++place) {
      const float* gradient = pair_gradients + static_cast<int64_t>(*place) * kPairGradients;
      for (int j = 0; j < kPairGradients; ++j) sum[j] += gradient[j];
    }
    if (raster.level(i) != 0) {
      const float* color = colors + 3 * i;
      const float by_gain = color[0] * sum[5] + color[1] * sum[6] + color[2] * sum[7];
      to_pixels(raster.factor(i), raster.level(i), by_gain, sum, sum + 2);
      for (int j = 5; j < kPairGradients; ++j) sum[j] *= raster.footprint(i).gain;
    }
    std::copy_n(sum, 2, out.means + 2 * i);
    std::copy_n(sum + 2, 3, out.factors + 3 * i);
    std::copy_n(sum + 5, 3, out.colors + 3 * i);
  });
}

// Computes gradients. fill(tile, part, gradient, pair_gradients) must set both for each tile of the picture; gradient
// is [kTileHeight][3][kTileWidth], and `part` the task's own.
template <typename Fill>
void gradients(const Rasterization& raster, const float* colors, const Fill& fill, const MutableGaussians& out) {
  Scratch pair_gradients(static_cast<size_t>(raster.pairs()) * kPairGradients);  // all written below
  const auto gradients_of = [&](int tile) { return pair_gradients.get() + raster.first_pair(tile) * kPairGradients; };
  Planes planes(raster.grids(), Planes::Rows::kRoom, 2);
  const auto each = [&](int tile, Rasterization::Part& part, float* gradient) {
    if (tile < raster.tiles(0)) fill(tile, part, gradient, gradients_of(tile));
    else fit_kernels(raster.isa()).backward(raster, tile, colors, gradient, gradients_of(tile));
  };
  Reduction(raster, each, planes).run();
  sum_pairs(raster, colors, pair_gradients.get(), out);
}

int64_t samples(const Rasterization& raster) { return 3 * static_cast<int64_t>(raster.width()) * raster.height(); }

double mean(const Rasterization& raster, const std::vector<double>& errors) {
  return std::accumulate(errors.begin(), errors.end(), 0.0) / static_cast<double>(samples(raster));
}

TileTarget target_of(const Rasterization& raster, int tile, const int16_t* target, float scale) {
  const Rasterization::Area a = raster.area(tile);
  const int64_t first = static_cast<int64_t>(a.y) * raster.width() + a.x;
  return {target + first, samples(raster) / 3, raster.width(), 0, a.columns, a.rows, scale};
}

// to = target - values, along a row of a tile.
SG_CLONES void subtract(const int16_t* target, const float* values, int columns, float* to) {
  constexpr float kStep = 1.0f / kTargetWhite;
  __builtin_prefetch(target + kAhead);
  float row[kTileWidth];
  if (columns == kTileWidth) {
    for (int i = 0; i < kTileWidth; ++i) row[i] = static_cast<float>(target[i]) * kStep - values[i];
    std::memcpy(to, row, sizeof row);
  } else {
    for (int i = 0; i < columns; ++i) to[i] = static_cast<float>(target[i]) * kStep - values[i];
  }
}

// Rows [3][kTileWidth] of a tile to half the size, [3][kTileWidth / 2].
SG_CLONES void halve(const float* in, int rows, float* out) {
  constexpr int kHalf = kTileWidth / 2, kRow = 3 * kTileWidth;
  for (int row = 0; row < rows; row += 2, in += 2 * kRow)
    for (int k = 0; k < 3; ++k, out += kHalf)
      for (int i = 0; i < kHalf; ++i) {
        const float* four = in + k * kTileWidth + 2 * i;
        out[i] = (four[0] + four[1] + (four[kRow] + four[kRow + 1])) * 0.25f;
      }
}

// Multiplies values of a tile of the picture by the visibility of their pixels.
void weigh(const Rasterization& raster, int tile, const int16_t* visibility, float* values) {
  const Rasterization::Area a = raster.area(tile);
  const int16_t* first = visibility + static_cast<int64_t>(a.y) * raster.width() + a.x;
  fit_kernels(raster.isa()).weigh(values, first, raster.width(), a.columns, a.rows);
}

}  // namespace

void missing(const Rasterization& raster, const float* colors, const int16_t* target, float* image) {
  raster.draw_tiles(colors, Rasterization::kBlack, [&](int tile, const float* values) {
    raster.for_rows(tile, values, [&](const float* from, int64_t at, int columns) {
      subtract(target + at, from, columns, image + at);
    });
  });
}

void missing_halved(const Rasterization& raster, const float* colors, const int16_t* target, float* image) {
  constexpr int kRow = 3 * kTileWidth;
  const int64_t width = (raster.width() + 1) / 2, height = (raster.height() + 1) / 2;
  raster.draw_tiles(colors, Rasterization::kBlack, [&](int tile, float* values) {
    raster.for_rows(tile, values,
                    [&](float* row, int64_t at, int columns) { subtract(target + at, row, columns, row); });
    const Rasterization::Area a = raster.area(tile);
    if (a.columns % 2 != 0)
      for (float* end = values + a.columns; end < values + a.rows * kRow; end += kTileWidth) end[0] = end[-1];
    if (a.rows % 2 != 0) std::copy_n(values + (a.rows - 1) * kRow, kRow, values + a.rows * kRow);
    alignas(64) float half[kTileFloats / 4];
    halve(values, a.rows, half);
    const float* from = half;
    for (int row = 0; row < a.rows; row += 2)
      for (int k = 0; k < 3; ++k, from += kTileWidth / 2)
        std::copy_n(from, (a.columns + 1) / 2, image + (k * height + (a.y + row) / 2) * width + a.x / 2);
  });
}

void draw_residual(const Rasterization& raster, const float* colors, const int16_t* target, const Strips& residual,
                   Planes& reduced, const int16_t* visibility) {
  Planes coarse(raster.grids(), Planes::Rows::kWhole, 2);
  raster.draw_coarse(colors, 2, coarse);
  const auto each = [&](int tile, Rasterization::Part& part, float* values) {
    if (tile >= raster.tiles(0)) return;
    raster.draw_tile(tile, coarse, colors, part, values);
    fit_kernels(raster.isa()).difference(values, target_of(raster, tile, target, -1.0f));
    const Rasterization::Area a = raster.area(tile);
    std::memcpy(residual.row(a.x / kTileWidth, a.y), values,
                static_cast<size_t>(a.rows) * 3 * kTileWidth * sizeof(float));
    if (visibility != nullptr) weigh(raster, tile, visibility, values);
  };
  Reduction(raster, each, reduced).run();
}

void backward(const Rasterization& raster, const float* colors, const float* image_grad, const MutableGaussians& out) {
  const auto fill = [&](int tile, Rasterization::Part&, float* gradient, float* pair_gradients) {
    std::fill_n(gradient, kTileFloats, 0.0f);
    raster.for_rows(tile, gradient,
                    [&](float* to, int64_t at, int columns) { std::copy_n(image_grad + at, columns, to); });
    fit_kernels(raster.isa()).backward(raster, tile, colors, gradient, pair_gradients);
  };
  gradients(raster, colors, fill, out);
}

void gram(const Rasterization& raster, const float* colors, float* out_colors, const int16_t* visibility) {
  const auto n = static_cast<size_t>(raster.gaussians());
  std::vector<float> means(2 * n), factors(3 * n);  // not needed
  Planes coarse(raster.grids(), Planes::Rows::kWhole, 2);
  raster.draw_coarse(colors, 2, coarse);
  const auto fill = [&](int tile, Rasterization::Part& part, float* picture, float* pair_gradients) {
    raster.draw_tile(tile, coarse, colors, part, picture);
    const Rasterization::Area a = raster.area(tile);  // beyond it, values are set to zero
    for (int row = 0; row < kTileHeight * 3; ++row) {
      float* const values = picture + row * kTileWidth;
      std::fill(values + (row < a.rows * 3 ? a.columns : 0), values + kTileWidth, 0.0f);
    }
    if (visibility != nullptr) weigh(raster, tile, visibility, picture);
    fit_kernels(raster.isa()).backward(raster, tile, colors, picture, pair_gradients);
  };
  gradients(raster, colors, fill, {means.data(), factors.data(), out_colors});
}

double squared_error(const Rasterization& raster, const float* colors, const int16_t* target,
                     const MutableGaussians& out, const int16_t* visibility, const Seen& seen, const Coarse& coarse) {
  if (raster.canvas().x != 0 || raster.canvas().y != 0) refuse<std::invalid_argument>("a fit is of the whole picture");
  const float scale = 2.0f / static_cast<float>(samples(raster));
  Planes wide(raster.grids(), Planes::Rows::kWhole, 2);
  raster.draw_coarse(colors, 2, wide);
  std::vector<double> errors(static_cast<size_t>(raster.tiles(0)));
  const auto fill = [&](int tile, Rasterization::Part& part, float* gradient, float* pair_gradients) {
    const std::unique_ptr<float[]> first(new float[first_value_count(raster, tile)]);  // all written by the kernel
    raster.begin_tile(tile, wide, colors, part, gradient);
    TileTarget here = target_of(raster, tile, target, scale);
    here.ahead = kAhead;
    if (visibility != nullptr) here.visibility = visibility + (here.first - target);
    here.seen = seen;
    here.coarse = coarse;
    errors[static_cast<size_t>(tile)] =
        fit_kernels(raster.isa()).squared_error(raster, tile, colors, here, first.get(), gradient, pair_gradients);
  };
  gradients(raster, colors, fill, out);
  return mean(raster, errors);
}

double squared_error(const Rasterization& raster, const float* colors, const int16_t* target) {
  std::vector<double> errors(static_cast<size_t>(raster.tiles(0)));
  raster.draw_tiles(colors, Rasterization::kBlack, [&](int tile, float* values) {
    const TileTarget here = target_of(raster, tile, target, 0.0f);
    errors[static_cast<size_t>(tile)] = fit_kernels(raster.isa()).difference(values, here);
  });
  return mean(raster, errors);
}

}  // namespace sg
