// The geometry of a set of Gaussians over a picture: which of them touch which tile, and in which rows. Built once per
// geometry; drawing with any colours, and gradients (fit/gradients.h), start from it.
//
// A tile has kTileWidth columns and kTileHeight rows. A lane of a vector is a column, so a Gaussian's value down a
// column is a recurrence of two multiplications (columns.h). In a pyramid the coarse levels (levels.h) have their own
// tiles, numbered after those of the picture.
#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <vector>

#include "core/thread_pool.h"
#include "raster/placed.h"
#include "raster/planes.h"
#include "texture/texture.h"

namespace sg {

constexpr int kTileFloats = 3 * kTileWidth * kTileHeight;  // values of a tile [kTileHeight][3][kTileWidth]
// A part of level 1 (Rasterization::Part) is under so many strips. It may begin anywhere within a strip of level 1.
constexpr int kPartStrips = 16, kPartRows = kTileHeight / 2 + 2;
constexpr int kPartColumns = kPartStrips * kTileWidth / 2 + kTileWidth;
constexpr int kPartFloats = 3 * kPartColumns * kPartRows + kTileWidth;  // enlarging reads beyond the last row
constexpr int64_t kMaxPairs = INT32_MAX;  // of Gaussian and tile; memory runs out long before

// Most pairs that n Gaussians over a picture may need. Fitted ones need at most a fifth of this (six pictures from 0.03
// to 12 bpp, among them noise and a constant). In a hostile file every Gaussian could cover everything.
int64_t max_pairs_of(int n, int width, int height);

struct Pair {
  int32_t gaussian;
  uint8_t first_row, last_row;  // within the tile, inclusive
  uint8_t first_lane, last_lane;  // the same
};

// The part of a picture to draw, and the rules of drawing.
struct Canvas {
  int x = 0, y = 0;  // of the first pixel
  int width, height;  // pixels
  float cutoff;  // sigma at which a Gaussian ends
  bool pyramid;  // whether wide Gaussians are drawn on coarser levels
  std::shared_ptr<const Texture> texture = nullptr;  // only with a pyramid
};

// At most `limit` Gaussians, produced one after the other. bring(there) produces them all, and calls there(n) once the
// first n are there. values() writes those of [first, last): means [last - first, 2] and factors [last - first, 3].
struct StreamedGaussians {
  int limit;
  std::function<void(const std::function<void(int)>& there)> bring;
  std::function<void(int first, int last, float* means, float* factors)> values;
};

class Rasterization {
 public:
  // means [n, 2] in pixels, factors [n, 3] = (l1, l2, l3) in pixels. Gaussians that are not finite or have l1 or l3 <=
  // 0 contribute nothing. isa: one of core/isa.h, or below 0 for the best. Throws std::overflow_error for more than
  // max_pairs pairs of Gaussian and tile, to which memory and time are proportional; std::invalid_argument for an
  // invalid size, cutoff or instruction set.
  Rasterization(const float* means, const float* factors, int n, const Canvas& canvas, int isa, int64_t max_pairs);
  // The same while the Gaussians are still being produced, with max_pairs_of() as the limit.
  Rasterization(const StreamedGaussians& stream, const Canvas& canvas);

  // image [3, height, width] = sum of colours times weights.
  void render(const float* colors, float* image) const;
  // image [height, width, 3]: background [3] plus the Gaussians, clamped to [0, 1] and rounded to 8 bits.
  void render_bytes(const float* colors, const float* background, uint8_t* image) const;

  int gaussians() const { return n_; }
  int width() const { return canvas_.width; }
  int height() const { return canvas_.height; }
  const std::vector<Grid>& grids() const { return grids_; }  // of levels 0 to that of the widest Gaussian

  float floor() const { return floor_; }  // exp(-cutoff)
  const Footprint& footprint(int gaussian) const { return footprints_[gaussian]; }
  const Pair* tile_begin(int tile) const { return pairs_.get() + tile_start_[tile]; }
  const Pair* tile_end(int tile) const { return pairs_.get() + tile_start_[tile + 1]; }
  // A tile's first sample, and the number of its rows within its level.
  int tile_x(int tile) const { return corner(tile).x; }
  int tile_y(int tile) const { return corner(tile).y; }
  int rows_of(int tile) const;

  // Access for gradients (fit/).
  const Canvas& canvas() const { return canvas_; }
  int isa() const { return isa_; }
  int level(int gaussian) const { return levels_[gaussian]; }
  const float* factor(int gaussian) const { return &factors_[3 * static_cast<int64_t>(gaussian)]; }
  int first_tile(int level) const { return first_tile_[level]; }
  int tiles(int level) const { return first_tile_[level + 1] - first_tile_[level]; }
  int64_t first_pair(int tile) const { return tile_start_[tile]; }  // index among the pairs of all tiles
  int64_t pairs() const { return tile_start_.back(); }

  // The part of a tile within the picture: its place there, and the rows and columns to skip in the tile.
  struct Area {
    int x, y, columns, rows, skip_columns, skip_rows;
  };
  Area area(int tile) const;
  static constexpr float kBlack[3] = {};
  // Draws the levels from the top down to `last`, each including those above it.
  void draw_coarse(const float* colors, int last, Planes& planes) const;
  // A level's samples to be enlarged, in rows of three colours, `stride` floats long. None at the top.
  struct Samples {
    const float* first = nullptr;
    int64_t stride = 0;
  };
  // Level 1 under some strips of a row of tiles of the picture. It has a quarter of the picture's samples: too many to
  // read back from memory. So each task draws the part that it enlarges, where it stays in the cache, and the rows and
  // columns at the edges of parts are drawn twice.
  struct Part {
    int first_tile = -1;
    Samples level_1;
    alignas(64) float values[kPartFloats];
  };
  // A tile of the picture [kTileHeight][3][kTileWidth], without and with its own Gaussians. coarse: drawn down to level
  // 2. part: the task's own, drawn anew where it ends.
  void begin_tile(int tile, Planes& coarse, const float* colors, Part& part, float* values) const;
  void draw_tile(int tile, Planes& coarse, const float* colors, Part& part, float* values) const;
  // Calls take(tile, its values) for each tile of the picture, on a background [3].
  template <typename Take>
  void draw_tiles(const float* colors, const float* background, const Take& take) const;
  // Calls take(values, place in an image [3, height, width], columns) for the rows of a tile.
  template <typename Value, typename Take>
  void for_rows(int tile, Value* values, const Take& take) const;
  // Calls take(gaussian, begin, end) for each Gaussian, with the indices of its pairs among those of all tiles.
  template <typename Take>
  void for_places(const Take& take) const;

 private:
  struct Corner {
    int x, y;
  };
  // Rows of a tile, from `first` to before `end`.
  struct Rows {
    int first, end;
  };
  // Some consecutive Gaussians, and their pairs, strip by strip.
  struct Bin {
    Bin() = default;
    Bin(int first_gaussian, int end, int tiles);
    int first = 0;  // Gaussian
    std::vector<int32_t> counts;  // number of each Gaussian's pairs
    std::vector<int32_t> places;  // each pair's index in pairs_; before sorting, its tile
    std::vector<Pair> pairs;  // until they are sorted into pairs_
    std::vector<int32_t> next;  // [tiles] number of pairs in each tile; while sorting, the index of the next one
  };
  int top() const { return static_cast<int>(grids_.size()) - 1; }
  int tiles() const { return first_tile_.back(); }
  int level_of_tile(int tile) const;
  Corner corner(int tile) const;
  void set_levels(int top);
  using Chunk = std::function<void(int first, int last, int chunk)>;
  using EachChunk = std::function<void(const Chunk& body)>;  // of chunk_ Gaussians
  Rasterization(const Canvas& canvas, int isa, int n);
  void lay_out(const float* means, int64_t max_pairs);
  int64_t find_pairs(const float* means, int64_t limit, int64_t most_kept, const EachChunk& each_chunk);
  void set_textures();
  void bin(const Crossings& crossings, int64_t pairs, Bin& bin) const;
  void sort_pairs();

  Samples below(Planes& planes, int tile) const;
  void draw_coarse_tile(int tile, Rows rows, Samples coarse, const float* colors, float* to, int64_t stride) const;
  Samples under(int tile, Planes& coarse, const float* colors, Part& part) const;
  Samples draw_part(Planes& planes, int strip, int block, const float* colors, float* samples) const;
  void begin_tile(Rows rows, Samples coarse, const float* background, float* accumulators) const;
  void add_texture(int tile, Rows rows, float* accumulators) const;
  void draw_tile(int tile, Rows rows, Samples coarse, const float* background, const float* colors,
                 float* accumulators) const;
  void write_bytes(int tile, const float* accumulators, uint8_t* image) const;

  const Canvas canvas_;
  int n_, isa_;
  int chunk_ = 0;  // Gaussians in a bin
  float reach_, floor_;
  std::vector<Footprint> footprints_;
  std::vector<float> factors_;  // in pixels
  std::vector<uint8_t> levels_;
  std::vector<Grid> grids_;  // of levels 0, 1, ...
  std::vector<TextureLayer> texture_;  // of levels 0, 1, ...; empty without texture
  std::vector<int> first_tile_;  // [levels + 1]
  std::vector<Bin> bins_;
  std::unique_ptr<Pair[]> pairs_;  // sorted by tile, then by Gaussian
  std::vector<int64_t> tile_start_;  // [tiles + 1]
};

template <typename Take>
void Rasterization::draw_tiles(const float* colors, const float* background, const Take& take) const {
  Planes coarse(grids_, Planes::Rows::kWhole, 2);
  draw_coarse(colors, 2, coarse);
  const int strips = grids_[0].strips(), across = (strips + kPartStrips - 1) / kPartStrips;
  parallel_for(across * grids_[0].blocks(), [&](int k) {
    Part part;
    alignas(64) float values[kTileFloats];
    const int first = k / across * strips + k % across * kPartStrips, end = (k / across + 1) * strips;
    for (int tile = first; tile < std::min(first + kPartStrips, end); ++tile) {
      draw_tile(tile, {0, rows_of(tile)}, under(tile, coarse, colors, part), background, colors, values);
      take(tile, values);
    }
  });
}

template <typename Value, typename Take>
void Rasterization::for_rows(int tile, Value* values, const Take& take) const {
  const Area a = area(tile);
  for (int row = 0; row < a.rows; ++row)
    for (int k = 0; k < 3; ++k)
      take(values + ((a.skip_rows + row) * 3 + k) * kTileWidth + a.skip_columns,
           (static_cast<int64_t>(k) * height() + a.y + row) * width() + a.x, std::max(a.columns, 0));
}

template <typename Take>
void Rasterization::for_places(const Take& take) const {
  parallel_chunks(n_, chunk_, [&](int first, int last, int k) {
    const int32_t* place = bins_[k].places.data();
    for (int i = first; i < last; ++i) {
      const int32_t* const end = place + bins_[k].counts[i - first];
      take(i, place, end);
      place = end;
    }
  });
}

}  // namespace sg
