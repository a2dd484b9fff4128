#include "raster/levels.h"

namespace sg {

std::vector<Grid> grids_of(int x, int y, int width, int height, int top) {
  const auto floor_to = [](int place, int multiple) { return place / multiple * multiple; };
  std::vector<Grid> grids(static_cast<size_t>(top) + 1);
  int end_x = x + width, end_y = y + height;
  grids[0].x = floor_to(x, kTileWidth);
  grids[0].y = floor_to(y, kTileHeight);
  for (int level = 0;; ++level) {
    Grid& grid = grids[static_cast<size_t>(level)];
    grid.width = end_x - grid.x;
    grid.height = end_y - grid.y;
    if (level == top) return grids;
    Grid& coarse = grids[static_cast<size_t>(level) + 1];
    coarse.x = floor_to(coarse_of(grid.x, level), kTileWidth);
    coarse.y = floor_to(coarse_of(grid.y, level), kTileHeight);
    // Samples are enlarged in pairs, each from three.
    end_x = coarse_of(end_x - 1, level) + 3;
    end_y = coarse_of(end_y - 1, level) + 3;
  }
}

}  // namespace sg
