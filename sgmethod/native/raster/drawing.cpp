// What a Rasterization is built for: pictures, and gradients.
//
// A picture is drawn from the top of the pyramid. All coarse levels draw their own Gaussians, each is enlarged and added
// to the next, and each tile of the picture begins as its part of level 1, enlarged. Gradients go the other way: the
// gradient by a level's picture is that by the finer one, reduced, which is enlarging transposed.
#include <algorithm>
#include <cstring>
#include <memory>
#include <numeric>
#include <stdexcept>

#include "core/thread_pool.h"
#include "raster/kernels.h"
#include "raster/levels.h"
#include "raster/planes.h"
#include "raster/rasterization.h"

namespace sg {
namespace {

constexpr float kBlack[3] = {};

}  // namespace

Rasterization::Area Rasterization::area(int tile) const {
  const auto [x, y] = corner(tile);
  const int skip_columns = std::max(canvas_.x - x, 0), skip_rows = std::max(canvas_.y - y, 0);
  return {x + skip_columns - canvas_.x,
          y + skip_rows - canvas_.y,
          std::min(kTileWidth, canvas_.x + canvas_.width - x) - skip_columns,
          std::min(kTileHeight, canvas_.y + canvas_.height - y) - skip_rows,
          skip_columns,
          skip_rows};
}

// Draws levels 1 to the top, each with all above it.
void Rasterization::draw_coarse(const float* colors, Planes& planes) const {
  for (int level = top(); level >= 1; --level)
    parallel_for(tiles(level), [&](int k) {
      const int tile = first_tile_[level] + k, rows = rows_of(tile);
      alignas(64) float acc[kTileFloats];
      draw_tile(planes, tile, kBlack, colors, acc);
      const auto [x, y] = corner(tile);
      const Grid& grid = grids_[level];
      const int columns = std::min(kTileWidth, grid.x + grid.width - x);
      const int64_t stride = planes.stride(level);
      float* to = planes.at(level, x, y);
      for (const float *from = acc, *end = acc + rows * 3 * kTileWidth; from != end; from += kTileWidth, to += stride)
        for (int i = 0; i < columns; ++i) to[i] = from[i] * (1.0f / 16.0f);  // as enlarging wants them
    });
}

// What lies below the Gaussians that a tile draws itself: its part of the next level, enlarged, on a background.
void Rasterization::begin_tile(Planes& planes, int tile, const float* background, float* accumulators) const {
  const int level = level_of_tile(tile);
  if (level == top()) {
    for (int i = 0; i < 3 * kTileWidth; ++i) accumulators[i] = background[i / kTileWidth];
    for (int row = 1; row < kTileHeight; ++row)
      std::memcpy(accumulators + row * 3 * kTileWidth, accumulators, 3 * kTileWidth * sizeof(float));
    return;
  }
  const auto [x, y] = corner(tile);
  const float* coarse = planes.at(level + 1, coarse_of(x, level), coarse_of(y, level));
  kernels(isa_).enlarge(coarse, planes.stride(level + 1), rows_of(tile), background, accumulators);
}

void Rasterization::draw_tile(Planes& planes, int tile, const float* background, const float* colors,
                              float* accumulators) const {
  begin_tile(planes, tile, background, accumulators);
  kernels(isa_).forward(*this, tile, colors, accumulators);
}

// Rows of a tile, as far as its level goes.
int Rasterization::rows_of(int tile) const {
  const Grid& grid = grids_[level_of_tile(tile)];
  return std::min(kTileHeight, grid.y + grid.height - corner(tile).y);
}

void Rasterization::render(const float* colors, float* image) const {
  Planes coarse(grids_, Planes::Rows::kWhole);
  draw_coarse(colors, coarse);
  parallel_for(tiles(0), [&](int tile) {
    alignas(64) float acc[kTileFloats];
    draw_tile(coarse, tile, kBlack, colors, acc);
    const Area a = area(tile);
    for (int row = 0; row < a.rows; ++row)
      for (int k = 0; k < 3; ++k)
        std::copy_n(acc + ((a.skip_rows + row) * 3 + k) * kTileWidth + a.skip_columns, std::max(a.columns, 0),
                    image + (static_cast<int64_t>(k) * height() + a.y + row) * width() + a.x);
  });
}

void Rasterization::render_bytes(const float* colors, const float* background, uint8_t* image) const {
  Planes coarse(grids_, Planes::Rows::kWhole);
  draw_coarse(colors, coarse);
  parallel_for(tiles(0), [&](int tile) {
    alignas(64) float acc[kTileFloats];
    draw_tile(coarse, tile, background, colors, acc);
    const Area a = area(tile);
    const float* from = acc + a.skip_rows * 3 * kTileWidth;
    const int64_t stride = 3 * int64_t{width()};
    uint8_t* to = image + a.y * stride + 3 * int64_t{a.x};
    if (a.skip_columns == 0) {
      kernels(isa_).bytes(from, a.columns, a.rows, to, stride);
      return;
    }
    uint8_t whole[3 * kTileWidth * kTileHeight];
    kernels(isa_).bytes(from, kTileWidth, a.rows, whole, 3 * kTileWidth);
    for (int row = 0; row < a.rows; ++row)
      std::copy_n(whole + 3 * (row * kTileWidth + a.skip_columns), 3 * std::max(a.columns, 0), to + row * stride);
  });
}

// Calls fill(tile, gradient, pair gradients) for each tile of the picture, which sets both; gradient is laid out as
// accumulators are.
template <typename Fill>
void Rasterization::gradients(const float* colors, const Fill& fill, const Gradients& out) const {
  Scratch pair_gradients(static_cast<size_t>(tile_start_.back()) * kPairGradients);  // all written below
  const auto gradients_of = [&](int tile) { return pair_gradients.get() + tile_start_[tile] * kPairGradients; };
  Planes planes(grids_);
  const auto each = [&](int tile, float* gradient) {
    if (tile < tiles(0)) fill(tile, gradient, gradients_of(tile));
    else fit_kernels(isa_).backward(*this, tile, colors, gradient, gradients_of(tile));
  };
  reduce_all(each, planes);
  sum_pairs(colors, pair_gradients.get(), out);
}

// Reduces the picture to all coarse levels. Calls each(tile, values) for each tile of every level: it sets what is
// reduced for those of the picture, and gets it for the others.
template <typename Each>
void Rasterization::reduce_all(const Each& each, Planes& planes) const {
  for (int level = 0; level <= top(); ++level)
    reduce(level, planes, [&](int tile, float* values) {
      if (level != 0) load(planes, tile, values);
      each(tile, values);
    });
}

// Reduces one level to the next. A task is a row of tiles, whose results overlap: they are added up while they are in the
// processor's cache. Those of neighbouring rows of tiles overlap by two rows, which are kept aside and added at the end.
template <typename Load>
void Rasterization::reduce(int level, Planes& planes, const Load& load_tile) const {
  constexpr int kRows = kTileHeight / 2, kColumns = kTileWidth / 2, kOver = kReducedRows - kRows;
  const Grid& grid = grids_[level];
  if (level == top()) {
    parallel_for(grid.tiles(), [&](int k) {
      alignas(64) float values[kTileFloats];
      load_tile(first_tile_[level] + k, values);
    });
    return;
  }
  const Grid& below = grids_[level + 1];
  const int x0 = coarse_of(grid.x, level), y0 = coarse_of(grid.y, level);
  const int64_t stride = planes.stride(level + 1), row_floats = 3 * stride;
  Scratch over(static_cast<size_t>(grid.blocks() * kOver * row_floats));
  // What lies above and below all that is reduced belongs to no pixel.
  planes.clear(level + 1, below.y, y0);
  parallel_for(grid.blocks(), [&](int block) {
    const int y = y0 + block * kRows, rows = std::min(kRows, below.y + below.height - y);
    float* aside = over.get() + block * kOver * row_floats;
    planes.clear(level + 1, y, block + 1 == grid.blocks() ? below.y + below.height : y + rows);
    std::fill_n(aside, kOver * row_floats, 0.0f);
    for (int strip = 0; strip < grid.strips(); ++strip) {
      alignas(64) float values[kTileFloats];
      alignas(64) float reduced[kReducedFloats];
      load_tile(first_tile_[level] + block * grid.strips() + strip, values);
      fit_kernels(isa_).reduce(values, reduced);
      const int x = x0 + strip * kColumns;
      fit_kernels(isa_).add_rows(reduced, rows, planes.at(level + 1, x, y), stride);
      fit_kernels(isa_).add_rows(reduced + kRows * 3 * kTileWidth, kOver, aside + (x - below.x), stride);
    }
  });
  for (int block = 0; block < grid.blocks(); ++block)
    for (int row = 0; row < kOver; ++row) {
      const int y = y0 + (block + 1) * kRows + row;
      if (y >= below.y + below.height) continue;
      const float* from = over.get() + (block * kOver + row) * row_floats;
      float* to = planes.at(level + 1, below.x, y);
      for (int64_t i = 0; i < row_floats; ++i) to[i] += from[i];
    }
}

// A tile of a coarse level, laid out as accumulators are.
void Rasterization::load(Planes& planes, int tile, float* values) const {
  const auto [x, y] = corner(tile);
  const int level = level_of_tile(tile), rows = rows_of(tile);
  for (int row = 0; row < rows; ++row)
    for (int k = 0; k < 3; ++k)
      std::memcpy(values + (3 * row + k) * kTileWidth, planes.at(level, x, y + row) + k * planes.stride(level),
                  kTileWidth * sizeof(float));
  std::fill(values + rows * 3 * kTileWidth, values + kTileFloats, 0.0f);
}

void Rasterization::backward(const float* colors, const float* image_grad, const Gradients& out) const {
  const auto fill = [&](int tile, float* gradient, float* pair_gradients) {
    std::fill_n(gradient, kTileFloats, 0.0f);
    const Area a = area(tile);
    for (int row = 0; row < a.rows; ++row)
      for (int k = 0; k < 3; ++k)
        std::copy_n(image_grad + (static_cast<int64_t>(k) * height() + a.y + row) * width() + a.x, std::max(a.columns, 0),
                    gradient + ((a.skip_rows + row) * 3 + k) * kTileWidth + a.skip_columns);
    fit_kernels(isa_).backward(*this, tile, colors, gradient, pair_gradients);
  };
  gradients(colors, fill, out);
}

void Rasterization::gram(const float* colors, float* out_colors) const {
  std::vector<float> means(2 * static_cast<size_t>(n_)), factors(3 * static_cast<size_t>(n_));  // not needed
  Planes coarse(grids_, Planes::Rows::kWhole);
  draw_coarse(colors, coarse);
  const auto fill = [&](int tile, float* picture, float* pair_gradients) {
    draw_tile(coarse, tile, kBlack, colors, picture);
    const Area a = area(tile);  // what lies beyond it is no part of the picture
    for (int row = 0; row < kTileHeight * 3; ++row)
      std::fill(picture + row * kTileWidth + (row < a.rows * 3 ? a.columns : 0), picture + (row + 1) * kTileWidth, 0.0f);
    fit_kernels(isa_).backward(*this, tile, colors, picture, pair_gradients);
  };
  gradients(colors, fill, {means.data(), factors.data(), out_colors});
}

void Rasterization::leave(const float* colors, const int16_t* target, const Strips& left, Planes& reduced) const {
  const int64_t plane = static_cast<int64_t>(width()) * height();
  Planes coarse(grids_, Planes::Rows::kWhole);
  draw_coarse(colors, coarse);
  const auto each = [&](int tile, float* values) {
    if (tile >= tiles(0)) return;
    draw_tile(coarse, tile, kBlack, colors, values);
    const Area a = area(tile);
    const TileTarget wanted{target + static_cast<int64_t>(a.y) * width() + a.x, plane, width(), 0, a.columns, a.rows, -1.0f};
    fit_kernels(isa_).difference(values, wanted);
    std::memcpy(left.row(a.x / kTileWidth, a.y), values, static_cast<size_t>(a.rows) * 3 * kTileWidth * sizeof(float));
  };
  reduce_all(each, reduced);
}

double Rasterization::squared_error(const float* colors, const int16_t* target, const Gradients& out) const {
  if (canvas_.x != 0 || canvas_.y != 0) throw std::invalid_argument("a fit is of the whole picture");
  const int64_t plane = static_cast<int64_t>(width()) * height();
  const float scale = 2.0f / static_cast<float>(3 * plane);
  Planes coarse(grids_, Planes::Rows::kWhole);
  draw_coarse(colors, coarse);
  std::vector<double> errors(tiles(0));
  // The processor does not foresee the rows of a large picture, because they lie too far apart. So each kernel asks for
  // those of the next tile.
  constexpr int ahead = 2 * kTileWidth - 1;
  const auto fill = [&](int tile, float* gradient, float* pair_gradients) {
    const Area a = area(tile);
    const TileTarget wanted{target + static_cast<int64_t>(a.y) * width() + a.x, plane, width(), ahead, a.columns, a.rows, scale};
    const std::unique_ptr<float[]> first(new float[first_value_count(*this, tile)]);  // all written by the kernel
    begin_tile(coarse, tile, kBlack, gradient);
    errors[tile] = fit_kernels(isa_).squared_error(*this, tile, colors, wanted, first.get(), gradient, pair_gradients);
  };
  gradients(colors, fill, out);
  return std::accumulate(errors.begin(), errors.end(), 0.0) / static_cast<double>(3 * plane);
}

}  // namespace sg
