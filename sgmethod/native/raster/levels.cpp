#include "raster/levels.h"

namespace sg {
// With a = p1^2, b = p1 p2, c = p2^2 + p3^2: q1 = sqrt(a - v), q2 = b / q1, q3 = sqrt(c - v - q2^2), and the gain is
// p1 p3 / (q1 q3). Here d_x is the gradient by x.
void to_pixels(const float* factor, int level, float by_gain, float* by_mean, float* by_factor) {
  if (level == 0) return;
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
