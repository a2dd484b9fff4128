// The geometry of a set of Gaussians laid over a pixel grid: which of them touch which tile, and in which
// rows. Built once per geometry; rendering with any colours, and the gradients, start from it.
//
// A tile is one strip of kTileWidth columns and kTileHeight rows. A lane of a vector owns a column, so a
// Gaussian's value down a column is a recurrence of two multiplications (see columns.h).
#pragma once

#include <cstdint>
#include <memory>
#include <vector>

#include "raster/footprint.h"

namespace sg {

constexpr int kTileFloats = 3 * kTileWidth * kTileHeight;  // of a picture
constexpr int64_t kMaxPairs = INT32_MAX;  // of Gaussian and tile; memory ends long before

struct Pair {
  int32_t gaussian;
  int16_t first_row, last_row;  // within the tile, inclusive
};

struct Gradients {
  float* means;    // [n, 2]
  float* factors;  // [n, 3]
  float* colors;   // [n, 3]
};

class Rasterization {
 public:
  // means [n, 2] in pixels, factors [n, 3] = (l1, l2, l3) in pixels. Gaussians that are not finite or have
  // l1 or l3 <= 0 contribute nothing. Throws std::overflow_error if more than max_pairs (Gaussian, tile) pairs
  // would be needed: memory and time follow that number. isa: one of core/isa.h, or below 0 for the best. Throws
  // std::invalid_argument for a size, cutoff or instruction set that cannot be.
  Rasterization(const float* means, const float* factors, int n, int width, int height, float cutoff, int isa,
                int64_t max_pairs);

  // image [3, height, width] = sum of colours times weights.
  void render(const float* colors, float* image) const;
  // image [height, width, 3]: background [3] plus the Gaussians, clamped to [0, 1] and rounded to 8 bits.
  void render_bytes(const float* colors, const float* background, uint8_t* image) const;
  // Gradients of a loss whose gradient by the image is image_grad [3, height, width].
  void backward(const float* colors, const float* image_grad, const Gradients& out) const;
  // The mean squared error against target [3, height, width], and its gradients: render, loss and backward at once, so
  // that no picture goes through memory.
  double squared_error(const float* colors, const float* target, const Gradients& out) const;

  int gaussians() const { return n_; }
  int width() const { return width_; }
  int height() const { return height_; }

  float floor() const { return floor_; }  // exp(-cutoff)
  const Footprint& footprint(int gaussian) const { return footprints_[gaussian]; }
  int strips() const { return strips_; }
  const Pair* tile_begin(int tile) const { return pairs_.get() + tile_start_[tile]; }
  const Pair* tile_end(int tile) const { return pairs_.get() + tile_start_[tile + 1]; }
  int64_t tile_offset(int tile) const { return tile_start_[tile]; }

 private:
  struct Area {
    int x, y, columns, rows;  // the tile's first pixel, and how much of the tile lies within the picture
  };
  Area area(int tile) const;
  // Some consecutive Gaussians, and their pairs in the order in which spans() finds them.
  struct Bin {
    int64_t at_most;              // pairs that there can be
    std::vector<int32_t> ends;    // for each Gaussian, the number of pairs up to its last
    std::vector<int32_t> places;  // where each pair lies in pairs_; before that is known, its tile
    std::vector<Pair> pairs;      // until they lie in pairs_
    std::vector<int32_t> next;    // [tiles] until then: the number of pairs in each tile, later the place of the next
  };
  template <typename Visit>
  int spans(int gaussian, const Visit& visit) const;
  void bin(int gaussian, Bin& bin) const;
  void sort_pairs();
  void sum_pairs(const float* pair_gradients, const Gradients& out) const;
  // The number of pairs, counted without memory and no further than the limit. A Gaussian counts as its strips where
  // these are more than its pairs: looking at them takes time too.
  int64_t pairs_up_to(int64_t limit) const;

  int n_, width_, height_, strips_, blocks_, isa_;
  int chunk_;  // Gaussians in a bin
  float reach_, floor_;
  std::vector<Footprint> footprints_;
  std::vector<float> factors_;
  std::vector<Bin> bins_;
  std::unique_ptr<Pair[]> pairs_;    // sorted by tile, then by Gaussian
  std::vector<int64_t> tile_start_;  // [tiles + 1]
};

}  // namespace sg
