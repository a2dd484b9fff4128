// Reducing a gradient by the picture to the coarse levels: the transpose of enlarging (raster/drawing.cpp).
#pragma once

#include <algorithm>
#include <cstdint>
#include <cstring>

#include "core/scratch.h"
#include "core/thread_pool.h"
#include "fit/fit_kernels.h"
#include "raster/levels.h"
#include "raster/planes.h"
#include "raster/rasterization.h"

namespace sg {

// Rows of a level in three colours, `stride` floats long. first: the red value of row y.
struct LevelRows {
  float* first;
  int y;
  int64_t stride;
  float* at(int row) const { return first + (row - y) * 3 * stride; }
  void clear(int from, int end) const {
    if (from < end) std::fill(at(from), at(end), 0.0f);
  }
};

// Reduces one level to the next. A task is a row of tiles, whose results overlap and are added while they are in the
// cache. Neighbouring rows of tiles overlap by two rows, which are kept aside until both are there. The top level's
// tiles are only loaded.
template <typename Load>
class LevelReduction {
 public:
  // load(tile, part, values) sets the values of one of the level's tiles; `part` is the task's own.
  LevelReduction(const Rasterization& raster, const Planes& planes, int level, const Load& load)
      : raster_(raster), level_(level), load_(load), grid_(planes.grid(level)),
        next_(planes.grid(std::min(level + 1, planes.top()))), is_top_(level == planes.top()),
        first_y_(coarse_of(grid_.y, level)), aside_floats_(is_top_ ? 0 : kOverRows * 3 * planes.stride(level + 1)),
        aside_(static_cast<size_t>(grid_.blocks() * aside_floats_)) {}

  int blocks() const { return grid_.blocks(); }
  // Rows of the next level before this are whole once the rows of tiles before `block` are reduced.
  int whole_before(int block) const { return block == blocks() ? next_.y + next_.height : first_y_ + block * kRows; }

  // Reduces the rows of tiles from `begin` to before `end`, once those before are reduced. to: the rows that change.
  void reduce(int begin, int end, const LevelRows& to) {
    if (begin == end) return;
    const int strips = grid_.strips();
    if (is_top_) {
      parallel_for((end - begin) * strips, [&](int k) {
        Rasterization::Part part;
        alignas(64) float values[kTileFloats];
        load_(raster_.first_tile(level_) + begin * strips + k, part, values);
      });
      return;
    }
    if (begin == 0) to.clear(next_.y, first_y_);  // rows that belong to no pixel, like those below the last
    parallel_for(end - begin, [&](int k) { reduce_block(begin + k, to); });
    const int first = std::max(begin - 1, 0), last = end == blocks() ? end : end - 1;
    parallel_each(last - first, kTogether, [&](int k) { add_aside(first + k, to); });
  }

 private:
  static constexpr int kRows = kTileHeight / 2, kColumns = kTileWidth / 2;
  static constexpr int kTogether = 8;  // rows of tiles whose overlaps one task adds

  void reduce_block(int block, const LevelRows& to) {
    const int x0 = coarse_of(grid_.x, level_) - next_.x, y = first_y_ + block * kRows;
    const int rows = std::min(kRows, next_.y + next_.height - y);
    float* const aside = aside_.get() + block * aside_floats_;
    to.clear(y, whole_before(block + 1));
    std::fill_n(aside, aside_floats_, 0.0f);
    alignas(64) float padded[kMarginFloats + kTileFloats + kMarginFloats] = {};
    float* const values = padded + kMarginFloats;
    Rasterization::Part part;
    for (int strip = 0; strip < grid_.strips(); ++strip) {
      load_(raster_.first_tile(level_) + block * grid_.strips() + strip, part, values);
      const int x = x0 + strip * kColumns;
      fit_kernels(raster_.isa()).reduce(values, rows, to.at(y) + x, aside + x, to.stride);
    }
  }

  void add_aside(int block, const LevelRows& to) {
    const int y = first_y_ + (block + 1) * kRows, rows = std::min(kOverRows, next_.y + next_.height - y);
    const float* const from = aside_.get() + block * aside_floats_;
    float* const sums = to.at(y);
    for (int64_t i = 0; i < rows * 3 * to.stride; ++i) sums[i] += from[i];
  }

  const Rasterization& raster_;
  const int level_;
  const Load load_;
  const Grid grid_, next_;
  const bool is_top_;
  const int first_y_;  // row of the next level to which the first row is reduced
  const int64_t aside_floats_;
  Scratch aside_;  // [blocks][kOverRows][3][stride]
};

// Reduces the picture to the coarse levels of planes. each(tile, part, values) is called for each tile of every level,
// to set the values of the picture's tiles, and to read those of the others. If planes hold no level 1, which is larger
// than all others together, only those rows of it that are being reduced take memory, and stay in the cache.
template <typename Each>
class Reduction {
 public:
  Reduction(const Rasterization& raster, const Each& each, Planes& planes)
      : raster_(raster), each_(each), planes_(planes) {}

  void run() {
    int level = 0;
    if (planes_.top() > 0 && !planes_.holds(1)) {
      reduce_two_levels();
      level = 2;
    }
    for (; level <= planes_.top(); ++level) {
      const LevelRows rows = rows_of(level);
      LevelReduction whole(raster_, planes_, level, loading(level, rows));
      whole.reduce(0, whole.blocks(), rows_of(level + 1));
    }
  }

 private:
  // The picture to level 1, and that to level 2, some rows of tiles at a time.
  void reduce_two_levels() {
    constexpr int kRows = kTileHeight / 2;
    constexpr int64_t kTogetherFloats = 1 << 20;  // 4 MB: within most third-level caches, and a small picture's whole
    constexpr int kTasks = 4;  // rows of tiles for each thread at least, so that none waits long for the others
    const Grid& level_1 = planes_.grid(1);
    const int64_t row_floats = 3 * planes_.stride(1);
    const int cached = static_cast<int>(kTogetherFloats / (kRows * row_floats));
    const int together = std::max(cached, kTasks * thread_count());
    Scratch memory(static_cast<size_t>((together + 4) * kRows * row_floats));
    LevelRows rows{memory.get(), level_1.y, planes_.stride(1)};
    LevelReduction picture(raster_, planes_, 0, loading(0, rows)), next(raster_, planes_, 1, loading(1, rows));
    for (int begin = 0, first = 0; begin < picture.blocks();) {
      const int end = std::min(begin + together, picture.blocks()), whole = picture.whole_before(end);
      picture.reduce(begin, end, rows);
      const int last = end == picture.blocks() ? next.blocks() : (whole - level_1.y) / kTileHeight;
      next.reduce(first, last, rows_of(2));
      const int kept = std::min(level_1.y + last * kTileHeight, whole);  // the rows of tiles that are not whole
      std::copy(rows.at(kept), rows.at(whole), rows.first);
      rows.y = kept, begin = end, first = last;
    }
  }

  // A level's rows in planes; none of the picture, and beyond the top.
  LevelRows rows_of(int level) const {
    if (level == 0 || level > planes_.top()) return {};
    const Grid& grid = planes_.grid(level);
    return {planes_.at(level, grid.x, grid.y), grid.y, planes_.stride(level)};
  }

  auto loading(int level, const LevelRows& rows) const {
    return [this, level, &rows](int tile, Rasterization::Part& part, float* values) {
      if (level != 0) {
        const float* const from = rows.at(raster_.tile_y(tile)) + (raster_.tile_x(tile) - planes_.grid(level).x);
        load(raster_.rows_of(tile), from, rows.stride, values);
      }
      each_(tile, part, values);
    };
  }

  // Loads a coarse level's tile to values [kTileHeight][3][kTileWidth].
  static void load(int rows, const float* from, int64_t stride, float* values) {
    for (int row = 0; row < 3 * rows; ++row, from += stride) {
      __builtin_prefetch(from + 2 * kTileWidth - 1);  // of the next tile
      std::memcpy(values + row * kTileWidth, from, kTileWidth * sizeof(float));
    }
    std::fill(values + rows * 3 * kTileWidth, values + kTileFloats, 0.0f);
  }

  const Rasterization& raster_;
  const Each& each_;
  Planes& planes_;
};

}  // namespace sg
