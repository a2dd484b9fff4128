// A value for each sample of the coarse levels (levels.h): pictures, or gradients by them.
#pragma once

#include <algorithm>
#include <cstdint>
#include <utility>
#include <vector>

#include "core/scratch.h"
#include "raster/footprint.h"

namespace sg {

// Rows of three colours, [height][3][stride], one level after the other, initially undefined.
class Planes {
 public:
  // kWhole: rows as wide as their samples, to draw; enlarging may read beyond a row, but not beyond the memory. kRoom:
  // rows with room for whole tiles and for what is reduced from them, which is wider.
  enum class Rows { kWhole, kRoom };

  // grids: of levels 0, 1, ...; levels below `lowest` take no memory.
  // spare: memory of so many floats that nobody needs meanwhile, which is taken if it is large enough.
  explicit Planes(std::vector<Grid> grids, Rows rows = Rows::kRoom, int lowest = 1, float* spare = nullptr,
                  size_t spare_floats = 0)
      : grids_(std::move(grids)), rows_(rows), offsets_(offsets(lowest)),
        own_(floats() <= spare_floats ? 0 : floats()), values_(floats() <= spare_floats ? spare : own_.get()) {}

  int top() const { return static_cast<int>(grids_.size()) - 1; }
  const Grid& grid(int level) const { return grids_[static_cast<size_t>(level)]; }
  // Whether a level takes memory.
  bool holds(int level) const {
    return offsets_[static_cast<size_t>(level) + 1] > offsets_[static_cast<size_t>(level)];
  }
  // Floats from one colour of a row to the next.
  int64_t stride(int level) const {
    return rows_ == Rows::kWhole ? grid(level).width : (grid(level).strips() + 1) * kTileWidth;
  }
  // The red value of the sample at (x, y) on the level.
  float* at(int level, int x, int y) {
    return values_ + offsets_[static_cast<size_t>(level)] +
           static_cast<int64_t>(y - grid(level).y) * 3 * stride(level) + (x - grid(level).x);
  }
  // Sets rows from `first` to before `end` to zero.
  void clear(int level, int first, int end) {
    if (first < end) std::fill_n(at(level, grid(level).x, first), (end - first) * 3 * stride(level), 0.0f);
  }

 private:
  size_t floats() const { return offsets_.back() + 2 * kTileWidth; }
  std::vector<size_t> offsets(int lowest) const {
    std::vector<size_t> ends(static_cast<size_t>(lowest) + 1, 0);
    for (int level = lowest; level <= top(); ++level)
      ends.push_back(ends.back() + static_cast<size_t>(grid(level).height * 3 * stride(level)));
    return ends;
  }
  std::vector<Grid> grids_;
  Rows rows_;
  std::vector<size_t> offsets_;  // [levels + 1]
  Scratch own_;
  float* const values_;
};

}  // namespace sg
