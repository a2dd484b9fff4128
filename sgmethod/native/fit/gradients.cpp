// Backpropagation, in the opposite order of drawing (raster/drawing.cpp): the gradient by a level's picture is that by
// the finer level's, reduced. Reducing is the transpose of enlarging.
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
#include "core/thread_pool.h"
#include "raster/levels.h"

namespace sg {
namespace {

// Rows of a large picture lie too far apart for the processor to prefetch them, so each kernel prefetches those of the
// next tile.
constexpr int kOverTogether = 8;  // rows of tiles whose overlaps one task adds
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

// Loads a tile of a coarse level to values [kTileHeight][3][kTileWidth].
void load(const Rasterization& raster, int level, int tile, Planes& planes, float* values) {
  const int rows = raster.rows_of(tile);
  const int64_t stride = planes.stride(level);
  const float* from = planes.at(level, raster.tile_x(tile), raster.tile_y(tile));
  for (int row = 0; row < 3 * rows; ++row, from += stride) {
    __builtin_prefetch(from + 2 * kTileWidth - 1);  // of the next tile
    std::memcpy(values + row * kTileWidth, from, kTileWidth * sizeof(float));
  }
  std::fill(values + rows * 3 * kTileWidth, values + kTileFloats, 0.0f);
}

// Reduces one level to the next. A task is a row of tiles, whose results overlap and are added while they are in the
// cache. Neighbouring rows of tiles overlap by two rows, which are kept aside and added at the end.
template <typename Load>
void reduce(const Rasterization& raster, int level, Planes& planes, const Load& load_tile) {
  constexpr int kRows = kTileHeight / 2, kColumns = kTileWidth / 2, kOver = kOverRows;
  const Grid& grid = planes.grid(level);
  const int first_tile = raster.first_tile(level);
  if (level == planes.top()) {
    parallel_for(grid.tiles(), [&](int k) {
      alignas(64) float values[kTileFloats];
      load_tile(first_tile + k, values);
    });
    return;
  }
  const Grid& below = planes.grid(level + 1);
  const int x0 = coarse_of(grid.x, level), y0 = coarse_of(grid.y, level);
  const int64_t stride = planes.stride(level + 1), row_floats = 3 * stride;
  Scratch over(static_cast<size_t>(grid.blocks() * kOver * row_floats));
  // Rows above and below the reduced ones belong to no pixel.
  planes.clear(level + 1, below.y, y0);
  parallel_for(grid.blocks(), [&](int block) {
    const int y = y0 + block * kRows, rows = std::min(kRows, below.y + below.height - y);
    float* aside = over.get() + block * kOver * row_floats;
    planes.clear(level + 1, y, block + 1 == grid.blocks() ? below.y + below.height : y + rows);
    std::fill_n(aside, kOver * row_floats, 0.0f);
    alignas(64) float padded[kMarginFloats + kTileFloats + kMarginFloats] = {};
    float* values = padded + kMarginFloats;
    for (int strip = 0; strip < grid.strips(); ++strip) {
      load_tile(first_tile + block * grid.strips() + strip, values);
      const int x = x0 + strip * kColumns;
      fit_kernels(raster.isa()).reduce(values, rows, planes.at(level + 1, x, y), aside + (x - below.x), stride);
    }
  });
  parallel_each(grid.blocks(), kOverTogether, [&](int block) {
    for (int row = 0; row < kOver; ++row) {
      const int y = y0 + (block + 1) * kRows + row;
      if (y >= below.y + below.height) continue;
      const float* from = over.get() + (block * kOver + row) * row_floats;
      float* to = planes.at(level + 1, below.x, y);
      for (int64_t i = 0; i < row_floats; ++i) to[i] += from[i];
    }
  });
}

// Reduces the picture to all coarse levels. Calls each(tile, values) for each tile of every level, to set the values of
// the picture's tiles, and to read those of the others.
template <typename Each>
void reduce_all(const Rasterization& raster, const Each& each, Planes& planes) {
  for (int level = 0; level <= planes.top(); ++level)
    reduce(raster, level, planes, [&](int tile, float* values) {
      if (level != 0) load(raster, level, tile, planes, values);
      each(tile, values);
    });
}

// Computes gradients. fill(tile, gradient, pair_gradients) must set both for each tile of the picture; gradient is
// [kTileHeight][3][kTileWidth].
template <typename Fill>
void gradients(const Rasterization& raster, const float* colors, const Fill& fill, const MutableGaussians& out) {
  Scratch pair_gradients(static_cast<size_t>(raster.pairs()) * kPairGradients);  // all written below
  const auto gradients_of = [&](int tile) { return pair_gradients.get() + raster.first_pair(tile) * kPairGradients; };
  Planes planes(raster.grids());
  const auto each = [&](int tile, float* gradient) {
    if (tile < raster.tiles(0)) fill(tile, gradient, gradients_of(tile));
    else fit_kernels(raster.isa()).backward(raster, tile, colors, gradient, gradients_of(tile));
  };
  reduce_all(raster, each, planes);
  sum_pairs(raster, colors, pair_gradients.get(), out);
}

int64_t samples(const Rasterization& raster) { return 3 * static_cast<int64_t>(raster.width()) * raster.height(); }

double mean(const Rasterization& raster, const std::vector<double>& errors) {
  return std::accumulate(errors.begin(), errors.end(), 0.0) / static_cast<double>(samples(raster));
}

TileTarget part(const Rasterization& raster, int tile, const int16_t* target, float scale) {
  const Rasterization::Area a = raster.area(tile);
  const int64_t first = static_cast<int64_t>(a.y) * raster.width() + a.x;
  return {target + first, samples(raster) / 3, raster.width(), 0, a.columns, a.rows, scale};
}

// to = target - values, along a row of a tile.
SG_CLONES void subtract(const int16_t* target, const float* values, int columns, float* to) {
  constexpr float kStep = 1.0f / kTargetWhite;
  __builtin_prefetch(target + kAhead);
  float left[kTileWidth];
  if (columns == kTileWidth) {
    for (int i = 0; i < kTileWidth; ++i) left[i] = static_cast<float>(target[i]) * kStep - values[i];
    std::memcpy(to, left, sizeof left);
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
  raster.draw_tiles(colors, [&](int tile, const float* values) {
    raster.for_rows(tile, values, [&](const float* from, int64_t at, int columns) {
      subtract(target + at, from, columns, image + at);
    });
  });
}

void missing_halved(const Rasterization& raster, const float* colors, const int16_t* target, float* image) {
  constexpr int kRow = 3 * kTileWidth;
  const int64_t width = (raster.width() + 1) / 2, height = (raster.height() + 1) / 2;
  raster.draw_tiles(colors, [&](int tile, float* values) {
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

void leave(const Rasterization& raster, const float* colors, const int16_t* target, const Strips& left, Planes& reduced,
           const int16_t* visibility) {
  Planes coarse(raster.grids(), Planes::Rows::kWhole);
  raster.draw_coarse(colors, 1, coarse);
  const auto each = [&](int tile, float* values) {
    if (tile >= raster.tiles(0)) return;
    raster.draw_tile(tile, coarse, colors, values);
    fit_kernels(raster.isa()).difference(values, part(raster, tile, target, -1.0f));
    const Rasterization::Area a = raster.area(tile);
    std::memcpy(left.row(a.x / kTileWidth, a.y), values, static_cast<size_t>(a.rows) * 3 * kTileWidth * sizeof(float));
    if (visibility != nullptr) weigh(raster, tile, visibility, values);
  };
  reduce_all(raster, each, reduced);
}

void backward(const Rasterization& raster, const float* colors, const float* image_grad, const MutableGaussians& out) {
  const auto fill = [&](int tile, float* gradient, float* pair_gradients) {
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
  Planes coarse(raster.grids(), Planes::Rows::kWhole);
  raster.draw_coarse(colors, 1, coarse);
  const auto fill = [&](int tile, float* picture, float* pair_gradients) {
    raster.draw_tile(tile, coarse, colors, picture);
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
                     const MutableGaussians& out, const int16_t* visibility, const Seen& seen) {
  if (raster.canvas().x != 0 || raster.canvas().y != 0) refuse<std::invalid_argument>("a fit is of the whole picture");
  const float scale = 2.0f / static_cast<float>(samples(raster));
  Planes coarse(raster.grids(), Planes::Rows::kWhole);
  raster.draw_coarse(colors, 1, coarse);
  std::vector<double> errors(static_cast<size_t>(raster.tiles(0)));
  const auto fill = [&](int tile, float* gradient, float* pair_gradients) {
    const std::unique_ptr<float[]> first(new float[first_value_count(raster, tile)]);  // all written by the kernel
    raster.begin_tile(tile, coarse, gradient);
    TileTarget here = part(raster, tile, target, scale);
    here.ahead = kAhead;
    if (visibility != nullptr) here.visibility = visibility + (here.first - target);
    here.seen = seen;
    errors[static_cast<size_t>(tile)] =
        fit_kernels(raster.isa()).squared_error(raster, tile, colors, here, first.get(), gradient, pair_gradients);
  };
  gradients(raster, colors, fill, out);
  return mean(raster, errors);
}

double squared_error(const Rasterization& raster, const float* colors, const int16_t* target) {
  std::vector<double> errors(static_cast<size_t>(raster.tiles(0)));
  raster.draw_tiles(colors, [&](int tile, float* values) {
    errors[static_cast<size_t>(tile)] = fit_kernels(raster.isa()).difference(values, part(raster, tile, target, 0.0f));
  });
  return mean(raster, errors);
}

}  // namespace sg
