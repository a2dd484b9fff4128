// Drawing a Rasterization.
//
// A picture is drawn from the top of the pyramid downwards. Each coarse level draws its own Gaussians on the enlarged
// level above, and each tile of the picture begins with its part of level 1, enlarged.
#include <algorithm>
#include <cstring>

#include "core/thread_pool.h"
#include "raster/kernels.h"
#include "raster/levels.h"
#include "raster/planes.h"
#include "raster/rasterization.h"

namespace sg {
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

void Rasterization::draw_coarse(const float* colors, int last, Planes& planes) const {
  for (int level = top(); level >= last; --level)
    parallel_for(tiles(level), [&](int k) {
      const int tile = first_tile_[level] + k;
      const auto [x, y] = corner(tile);
      draw_coarse_tile(tile, {0, rows_of(tile)}, below(planes, tile), colors, planes.at(level, x, y),
                       planes.stride(level));
    });
}

// Draws some rows of a coarse level's tile, divided by 16 as enlarging expects.
void Rasterization::draw_coarse_tile(int tile, Rows rows, Samples coarse, const float* colors, float* to,
                                     int64_t stride) const {
  alignas(64) float acc[kTileFloats];
  draw_tile(tile, rows, coarse, kBlack, colors, acc);
  const Grid& grid = grids_[level_of_tile(tile)];
  const int columns = std::min(kTileWidth, grid.x + grid.width - corner(tile).x);
  kernels(isa_).sixteenth(acc + rows.first * 3 * kTileWidth, columns, rows.end - rows.first, to, stride);
}

// The samples of the next level that are enlarged to a tile.
Rasterization::Samples Rasterization::below(Planes& planes, int tile) const {
  const int level = level_of_tile(tile);
  if (level == top()) return {};
  const auto [x, y] = corner(tile);
  return {planes.at(level + 1, coarse_of(x, level), coarse_of(y, level)), planes.stride(level + 1)};
}

// Starts a tile, before its own Gaussians: its part of the next level, enlarged, on a background.
void Rasterization::begin_tile(Rows rows, Samples coarse, const float* background, float* accumulators) const {
  const int first = rows.first / 2 * 2;  // rows are enlarged in pairs
  float* const to = accumulators + first * 3 * kTileWidth;
  if (coarse.first != nullptr) {
    const float* const from = coarse.first + first / 2 * 3 * coarse.stride;
    kernels(isa_).enlarge(from, coarse.stride, rows.end - first, background, to);
    return;
  }
  for (int i = 0; i < 3 * kTileWidth; ++i) to[i] = background[i / kTileWidth];
  for (int row = first + 1; row < rows.end; ++row)
    std::memcpy(accumulators + row * 3 * kTileWidth, to, 3 * kTileWidth * sizeof(float));
}

// Draws some rows of a tile. Their values do not depend on which rows are requested; the other rows are undefined.
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
      // Start at the beginning of a column segment.
      const int segment = footprints_[pair.gaussian].segment, before = std::max(rows.first - pair.first_row, 0);
      pair.first_row = static_cast<uint8_t>(pair.first_row + before / segment * segment);
      pair.last_row = static_cast<uint8_t>(std::min<int>(pair.last_row, rows.end - 1));
      ++count;
    }
    kernels(isa_).forward(*this, tile, inside, inside + count, colors, accumulators);
  }
}

void Rasterization::begin_tile(int tile, Planes& coarse, const float* colors, Part& part, float* values) const {
  begin_tile({0, rows_of(tile)}, under(tile, coarse, colors, part), kBlack, values);
}

void Rasterization::draw_tile(int tile, Planes& coarse, const float* colors, Part& part, float* values) const {
  draw_tile(tile, {0, rows_of(tile)}, under(tile, coarse, colors, part), kBlack, colors, values);
}

void Rasterization::add_texture(int tile, Rows rows, float* accumulators) const {
  const int level = level_of_tile(tile), border = border_of(level);
  const auto [x, y] = corner(tile);
  texture_[level].add(isa_, x - border, y - border, rows.first, rows.end, accumulators);
}

int Rasterization::rows_of(int tile) const {
  const Grid& grid = grids_[level_of_tile(tile)];
  return std::min(kTileHeight, grid.y + grid.height - corner(tile).y);
}

void Rasterization::render(const float* colors, float* image) const {
  draw_tiles(colors, kBlack, [&](int tile, const float* values) {
    for_rows(tile, values, [&](const float* from, int64_t at, int columns) { std::copy_n(from, columns, image + at); });
  });
}

void Rasterization::render_bytes(const float* colors, const float* background, uint8_t* image) const {
  draw_tiles(colors, background, [&](int tile, const float* values) { write_bytes(tile, values, image); });
}

// The samples of level 1 that are enlarged to a tile of the picture.
Rasterization::Samples Rasterization::under(int tile, Planes& coarse, const float* colors, Part& part) const {
  if (top() == 0) return {};
  const int strip = tile % grids_[0].strips(), within = strip % kPartStrips;
  if (part.first_tile != tile - within) {
    part.first_tile = tile - within;
    part.level_1 = draw_part(coarse, strip - within, tile / grids_[0].strips(), colors, part.values);
  }
  return {part.level_1.first + within * (kTileWidth / 2), part.level_1.stride};
}

// Draws the part of level 1 that is enlarged to a block's tiles from a strip on. samples: memory for it.
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
  // What is enlarged beyond the right edge is multiplied by a visibility of zero: it must be finite.
  const int drawn = std::min(grid.width - first_strip * kTileWidth, kPartColumns);
  for (int row = 0; row < 3 * (end - y); ++row)
    std::fill_n(samples + row * kPartColumns + drawn, std::min(kTileWidth, kPartColumns - drawn), 0.0f);
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

}  // namespace sg
