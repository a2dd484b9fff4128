// What a Rasterization is built for: pictures, and gradients.
//
// A picture is drawn from the top of the pyramid. All coarse levels draw their own Gaussians, each is enlarged and added
// to the next, and each tile of the picture begins as its part of level 1, enlarged. Gradients go the other way: the
// gradient by a level's picture is that by the finer one, reduced, which is enlarging transposed.
#include <algorithm>
#include <cstring>
#include <memory>
#include <numeric>

#include "core/errors.h"
#include "core/thread_pool.h"
#include "raster/kernels.h"
#include "raster/levels.h"
#include "raster/planes.h"
#include "raster/rasterization.h"

namespace sg {
namespace {

constexpr float kBlack[3] = {};

// What one task draws of the picture: so many strips of a row of tiles. The part of level 1 from which these are enlarged
// begins anywhere within a strip of its own.
constexpr int kPartStrips = 16, kPartRows = kTileHeight / 2 + 2;
constexpr int kPartColumns = kPartStrips * kTileWidth / 2 + kTileWidth;
constexpr int kPartFloats = 3 * kPartColumns * kPartRows + kTileWidth;  // enlarging reads beyond the last row

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

// Draws the levels from the top down to `last`, each with all above it.
void Rasterization::draw_coarse(const float* colors, int last, Planes& planes) const {
  for (int level = top(); level >= last; --level)
    parallel_for(tiles(level), [&](int k) {
      const int tile = first_tile_[level] + k;
      const auto [x, y] = corner(tile);
      draw_coarse_tile(tile, {0, rows_of(tile)}, below(planes, tile), colors, planes.at(level, x, y), planes.stride(level));
    });
}

// Some rows of a tile of a coarse level, as enlarging wants them.
void Rasterization::draw_coarse_tile(int tile, Rows rows, Samples coarse, const float* colors, float* to,
                                     int64_t stride) const {
  alignas(64) float acc[kTileFloats];
  draw_tile(tile, rows, coarse, kBlack, colors, acc);
  const Grid& grid = grids_[level_of_tile(tile)];
  const int columns = std::min(kTileWidth, grid.x + grid.width - corner(tile).x);
  kernels(isa_).sixteenth(acc + rows.first * 3 * kTileWidth, columns, rows.end - rows.first, to, stride);
}

// From where on the next level a tile is enlarged.
Rasterization::Samples Rasterization::below(Planes& planes, int tile) const {
  const int level = level_of_tile(tile);
  if (level == top()) return {};
  const auto [x, y] = corner(tile);
  return {planes.at(level + 1, coarse_of(x, level), coarse_of(y, level)), planes.stride(level + 1)};
}

// What lies below the Gaussians that a tile draws itself: its part of the next level, enlarged, on a background.
void Rasterization::begin_tile(Rows rows, Samples coarse, const float* background, float* accumulators) const {
  const int first = rows.first / 2 * 2;  // rows are enlarged in pairs
  float* const to = accumulators + first * 3 * kTileWidth;
  if (coarse.first != nullptr) {
    kernels(isa_).enlarge(coarse.first + first / 2 * 3 * coarse.stride, coarse.stride, rows.end - first, background, to);
    return;
  }
  for (int i = 0; i < 3 * kTileWidth; ++i) to[i] = background[i / kTileWidth];
  for (int row = first + 1; row < rows.end; ++row)
    std::memcpy(accumulators + row * 3 * kTileWidth, to, 3 * kTileWidth * sizeof(float));
}

// Some rows of a tile. Their values do not depend on which are asked for; what is in the others means nothing.
void Rasterization::draw_tile(int tile, Rows rows, Samples coarse, const float* background, const float* colors,
                              float* accumulators) const {
  begin_tile(rows, coarse, background, accumulators);
  if (!texture_.empty()) add_texture(tile, rows, accumulators);
  const Pair *begin = tile_begin(tile), *const end = tile_end(tile);
  if (rows.first == 0 && rows.end == rows_of(tile)) {
    kernels(isa_).forward(*this, tile, begin, end, colors, accumulators);
    return;
  }
  constexpr int kTogether = 128;
  Pair inside[kTogether];
  while (begin != end) {
    int count = 0;
    for (; begin != end && count < kTogether; ++begin) {
      Pair& pair = inside[count] = *begin;
      if (pair.last_row < rows.first || pair.first_row >= rows.end) continue;
      // From the beginning of one of its column segments.
      const int segment = footprints_[pair.gaussian].segment, before = std::max(rows.first - pair.first_row, 0);
      pair.first_row = static_cast<uint8_t>(pair.first_row + before / segment * segment);
      pair.last_row = static_cast<uint8_t>(std::min<int>(pair.last_row, rows.end - 1));
      ++count;
    }
    kernels(isa_).forward(*this, tile, inside, inside + count, colors, accumulators);
  }
}

void Rasterization::add_texture(int tile, Rows rows, float* accumulators) const {
  const int level = level_of_tile(tile), border = border_of(level);
  const auto [x, y] = corner(tile);
  texture_[level].add(isa_, x - border, y - border, rows.first, rows.end, accumulators);
}

// Rows of a tile, as far as its level goes.
int Rasterization::rows_of(int tile) const {
  const Grid& grid = grids_[level_of_tile(tile)];
  return std::min(kTileHeight, grid.y + grid.height - corner(tile).y);
}

// Calls take(tile, its values) for each tile of the picture.
template <typename Take>
void Rasterization::draw_tiles(const float* colors, const Take& take) const {
  Planes coarse(grids_, Planes::Rows::kWhole);
  draw_coarse(colors, 1, coarse);
  parallel_for(tiles(0), [&](int tile) {
    alignas(64) float values[kTileFloats];
    draw_tile(tile, {0, rows_of(tile)}, below(coarse, tile), kBlack, colors, values);
    take(tile, values);
  });
}

// Calls take(values, place in an image [3, height, width], columns) for the rows of a tile.
template <typename Value, typename Take>
void Rasterization::for_rows(int tile, Value* values, const Take& take) const {
  const Area a = area(tile);
  for (int row = 0; row < a.rows; ++row)
    for (int k = 0; k < 3; ++k)
      take(values + ((a.skip_rows + row) * 3 + k) * kTileWidth + a.skip_columns,
           (static_cast<int64_t>(k) * height() + a.y + row) * width() + a.x, std::max(a.columns, 0));
}

void Rasterization::render(const float* colors, float* image) const {
  draw_tiles(colors, [&](int tile, const float* values) {
    for_rows(tile, values, [&](const float* from, int64_t at, int columns) { std::copy_n(from, columns, image + at); });
  });
}

void Rasterization::missing(const float* colors, const int16_t* target, float* image) const {
  constexpr float kStep = 1.0f / kTargetWhite;
  draw_tiles(colors, [&](int tile, const float* values) {
    for_rows(tile, values, [&](const float* from, int64_t at, int columns) {
      for (int i = 0; i < columns; ++i) image[at + i] = static_cast<float>(target[at + i]) * kStep - from[i];
    });
  });
}

// Level 1 has a quarter of the picture's samples: too many to come back from memory. So a task draws the part of it that it
// enlarges, and rows and columns at the edges of a part are drawn twice.
void Rasterization::render_bytes(const float* colors, const float* background, uint8_t* image) const {
  Planes coarse(grids_, Planes::Rows::kWhole, 2);
  draw_coarse(colors, 2, coarse);
  const int across = (grids_[0].strips() + kPartStrips - 1) / kPartStrips;
  parallel_for(across * grids_[0].blocks(), [&](int k) {
    alignas(64) float level_1[kPartFloats];
    const int block = k / across, first = k % across * kPartStrips;
    const Samples part = top() == 0 ? Samples{} : draw_part(coarse, first, block, colors, level_1);
    for (int strip = first; strip < std::min(first + kPartStrips, grids_[0].strips()); ++strip) {
      const int tile = block * grids_[0].strips() + strip;
      const Samples here = {top() == 0 ? nullptr : part.first + (strip - first) * (kTileWidth / 2), part.stride};
      alignas(64) float acc[kTileFloats];
      draw_tile(tile, {0, rows_of(tile)}, here, background, colors, acc);
      write_bytes(tile, acc, image);
    }
  });
}

// The part of level 1 from which tiles of a block, from a strip on, are enlarged. samples: room for it.
Rasterization::Samples Rasterization::draw_part(Planes& planes, int strip, int block, const float* colors,
                                                float* samples) const {
  const Grid& grid = grids_[1];
  const int x = coarse_of(grids_[0].x + strip * kTileWidth, 0), y = coarse_of(grids_[0].y + block * kTileHeight, 0);
  const int end = std::min(y + kPartRows, grid.y + grid.height), first_strip = (x - grid.x) / kTileWidth;
  const int end_strip = std::min(first_strip + kPartColumns / kTileWidth, grid.strips());
  for (int from = y; from < end;) {
    const int in_block = (from - grid.y) / kTileHeight, top_row = grid.y + in_block * kTileHeight;
    const Rows rows{from - top_row, std::min(end - top_row, kTileHeight)};
    for (int s = first_strip; s < end_strip; ++s) {
      const int tile = first_tile_[1] + in_block * grid.strips() + s;
      float* to = samples + (from - y) * 3 * kPartColumns + (s - first_strip) * kTileWidth;
      draw_coarse_tile(tile, rows, below(planes, tile), colors, to, kPartColumns);
    }
    from = top_row + rows.end;
  }
  return {samples + (x - grid.x) % kTileWidth, kPartColumns};
}

void Rasterization::write_bytes(int tile, const float* accumulators, uint8_t* image) const {
  const Area a = area(tile);
  const float* from = accumulators + a.skip_rows * 3 * kTileWidth;
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
  constexpr int kRows = kTileHeight / 2, kColumns = kTileWidth / 2, kOver = kOverRows;
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
    alignas(64) float padded[kMarginFloats + kTileFloats + kMarginFloats] = {};
    float* values = padded + kMarginFloats;
    for (int strip = 0; strip < grid.strips(); ++strip) {
      load_tile(first_tile_[level] + block * grid.strips() + strip, values);
      const int x = x0 + strip * kColumns;
      fit_kernels(isa_).reduce(values, rows, planes.at(level + 1, x, y), aside + (x - below.x), stride);
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
  const int64_t stride = planes.stride(level);
  const float* from = planes.at(level, x, y);
  for (int row = 0; row < 3 * rows; ++row, from += stride)
    std::memcpy(values + row * kTileWidth, from, kTileWidth * sizeof(float));
  std::fill(values + rows * 3 * kTileWidth, values + kTileFloats, 0.0f);
}

void Rasterization::backward(const float* colors, const float* image_grad, const Gradients& out) const {
  const auto fill = [&](int tile, float* gradient, float* pair_gradients) {
    std::fill_n(gradient, kTileFloats, 0.0f);
    for_rows(tile, gradient, [&](float* to, int64_t at, int columns) { std::copy_n(image_grad + at, columns, to); });
    fit_kernels(isa_).backward(*this, tile, colors, gradient, pair_gradients);
  };
  gradients(colors, fill, out);
}

void Rasterization::gram(const float* colors, float* out_colors, const int16_t* visibility) const {
  std::vector<float> means(2 * static_cast<size_t>(n_)), factors(3 * static_cast<size_t>(n_));  // not needed
  Planes coarse(grids_, Planes::Rows::kWhole);
  draw_coarse(colors, 1, coarse);
  const auto fill = [&](int tile, float* picture, float* pair_gradients) {
    draw_tile(tile, {0, rows_of(tile)}, below(coarse, tile), kBlack, colors, picture);
    const Area a = area(tile);  // what lies beyond it is no part of the picture
    for (int row = 0; row < kTileHeight * 3; ++row)
      std::fill(picture + row * kTileWidth + (row < a.rows * 3 ? a.columns : 0), picture + (row + 1) * kTileWidth, 0.0f);
    if (visibility != nullptr) weigh(visibility, tile, picture);
    fit_kernels(isa_).backward(*this, tile, colors, picture, pair_gradients);
  };
  gradients(colors, fill, {means.data(), factors.data(), out_colors});
}

int64_t Rasterization::samples() const { return 3 * static_cast<int64_t>(width()) * height(); }

TileTarget Rasterization::part(const int16_t* target, int tile, int64_t ahead, float scale, const int16_t* visibility,
                               const Seen& seen) const {
  const Area a = area(tile);
  const int64_t first = static_cast<int64_t>(a.y) * width() + a.x;
  const int16_t* here = visibility == nullptr ? nullptr : visibility + first;
  return {target + first, samples() / 3, width(), ahead, a.columns, a.rows, scale, here, seen};
}

// values of a tile of the picture times the visibility of their pixels.
void Rasterization::weigh(const int16_t* visibility, int tile, float* values) const {
  const Area a = area(tile);
  fit_kernels(isa_).weigh(values, visibility + static_cast<int64_t>(a.y) * width() + a.x, width(), a.columns, a.rows);
}

double Rasterization::mean(const std::vector<double>& errors) const {
  return std::accumulate(errors.begin(), errors.end(), 0.0) / static_cast<double>(samples());
}

void Rasterization::leave(const float* colors, const int16_t* target, const Strips& left, Planes& reduced,
                          const int16_t* visibility) const {
  Planes coarse(grids_, Planes::Rows::kWhole);
  draw_coarse(colors, 1, coarse);
  const auto each = [&](int tile, float* values) {
    if (tile >= tiles(0)) return;
    draw_tile(tile, {0, rows_of(tile)}, below(coarse, tile), kBlack, colors, values);
    fit_kernels(isa_).difference(values, part(target, tile, 0, -1.0f, nullptr, kSeenAlike));
    const Area a = area(tile);
    std::memcpy(left.row(a.x / kTileWidth, a.y), values, static_cast<size_t>(a.rows) * 3 * kTileWidth * sizeof(float));
    if (visibility != nullptr) weigh(visibility, tile, values);
  };
  reduce_all(each, reduced);
}

double Rasterization::squared_error(const float* colors, const int16_t* target, const Gradients& out,
                                    const int16_t* visibility, const Seen& seen) const {
  if (canvas_.x != 0 || canvas_.y != 0) refuse<std::invalid_argument>("a fit is of the whole picture");
  const float scale = 2.0f / static_cast<float>(samples());
  Planes coarse(grids_, Planes::Rows::kWhole);
  draw_coarse(colors, 1, coarse);
  std::vector<double> errors(tiles(0));
  // The processor does not foresee the rows of a large picture, because they lie too far apart. So each kernel asks for
  // those of the next tile.
  constexpr int ahead = 2 * kTileWidth - 1;
  const auto fill = [&](int tile, float* gradient, float* pair_gradients) {
    const std::unique_ptr<float[]> first(new float[first_value_count(*this, tile)]);  // all written by the kernel
    begin_tile({0, rows_of(tile)}, below(coarse, tile), kBlack, gradient);
    const TileTarget here = part(target, tile, ahead, scale, visibility, seen);
    errors[tile] = fit_kernels(isa_).squared_error(*this, tile, colors, here, first.get(), gradient, pair_gradients);
  };
  gradients(colors, fill, out);
  return mean(errors);
}

double Rasterization::squared_error(const float* colors, const int16_t* target) const {
  std::vector<double> errors(tiles(0));
  draw_tiles(colors, [&](int tile, float* values) {
    errors[tile] = fit_kernels(isa_).difference(values, part(target, tile, 0, 0.0f, nullptr, kSeenAlike));
  });
  return mean(errors);
}

}  // namespace sg
