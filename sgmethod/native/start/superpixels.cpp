#include "start/superpixels.h"

#include <algorithm>
#include <array>
#include <cfloat>
#include <cstddef>
#include <utility>

#include "core/thread_pool.h"

namespace sg {
namespace {

constexpr int kRounds = 10;
constexpr int kBand = 32;         // rows of a task
constexpr int kSmallestPart = 4;  // a region is not smaller than the mean region by more than this factor
constexpr std::pair<int, int> kAround[] = {{-1, 0}, {-1, -1}, {0, -1}, {1, -1}, {1, 0}, {1, 1}, {0, 1}, {-1, 1}};
constexpr std::pair<int, int> kBeside[] = {{-1, 0}, {0, -1}, {1, 0}, {0, 1}};

// The mean of a region: its colour, then x and y.
using Seed = std::array<float, 5>;

struct Lab {
  const float* values;
  int width, height;
  size_t pixels() const { return static_cast<size_t>(width) * height; }
  size_t at(int x, int y) const { return static_cast<size_t>(y) * width + x; }
  bool has(int x, int y) const { return x >= 0 && x < width && y >= 0 && y < height; }
  Seed seed(int x, int y) const {
    const float* value = values + at(x, y);
    return {value[0], value[pixels()], value[2 * pixels()], static_cast<float>(x), static_cast<float>(y)};
  }
  // Squared magnitude of the gradient; that across the image's border is 0.
  float edge(int x, int y) const {
    float across = 0, down = 0;
    for (int k = 0; k < 3; ++k) {
      const float* value = values + k * pixels() + at(x, y);
      const float dx = x > 0 && x + 1 < width ? value[1] - value[-1] : 0;
      const float dy = y > 0 && y + 1 < height ? value[width] - value[-width] : 0;
      across += dx * dx;
      down += dy * dy;
    }
    return across + down;
  }
};

// Seeds on a grid, each moved to the least edge around it if that lies diagonally. Seeds beyond the image stay 0.
std::vector<Seed> first_seeds(const Lab& lab, int side) {
  const auto count = [&](int pixels) { return static_cast<int>(0.5f + static_cast<float>(pixels) / side); };
  const int columns = count(lab.width), rows = count(lab.height);
  const int step_x = side + (lab.width - side * columns) / columns, step_y = side + (lab.height - side * rows) / rows;
  std::vector<Seed> seeds(static_cast<size_t>(columns) * rows, Seed{});
  auto seed = seeds.begin();
  for (int row = 0; row < rows; ++row)
    for (int column = 0; column < columns; ++column) {
      const int x = column * step_x + side / 2, y = row * step_y + side / 2;
      if (lab.has(x, y)) *seed++ = lab.seed(x, y);
    }
  for (Seed& each : seeds) {
    const int x = static_cast<int>(each[3]), y = static_cast<int>(each[4]);
    int to_x = x, to_y = y;
    for (const auto& [dx, dy] : kAround)
      if (lab.has(x + dx, y + dy) && lab.edge(x + dx, y + dy) < lab.edge(to_x, to_y)) {
        to_x = x + dx;
        to_y = y + dy;
      }
    if (to_x != x && to_y != y) each = lab.seed(to_x, to_y);
  }
  return seeds;
}

// Gives each pixel of rows [first, last) the label of the nearest seed that reaches it; others keep theirs.
void assign(const Lab& lab, const std::vector<Seed>& seeds, int side, float spacing, int first, int last,
            int32_t* labels) {
  std::vector<float> nearest(static_cast<size_t>(last - first) * lab.width, FLT_MAX);
  for (size_t n = 0; n < seeds.size(); ++n) {
    const auto [l, a, b, seed_x, seed_y] = seeds[n];
    const int x = static_cast<int>(seed_x), y = static_cast<int>(seed_y);
    const int left = std::max(0, x - side), right = std::min(lab.width, x + side);
    for (int row = std::max(first, y - side); row < std::min(last, y + side); ++row) {
      const float* plane[3];
      for (int k = 0; k < 3; ++k) plane[k] = lab.values + k * lab.pixels() + lab.at(0, row);
      float* best = &nearest[static_cast<size_t>(row - first) * lab.width];
      int32_t* label = labels + lab.at(0, row);
      const float dy = row - seed_y;
      for (int column = left; column < right; ++column) {
        const float dl = plane[0][column] - l, da = plane[1][column] - a, db = plane[2][column] - b;
        const float dx = column - seed_x;
        const float distance = dl * dl + da * da + db * db + (dx * dx + dy * dy) / spacing;
        label[column] = distance < best[column] ? static_cast<int32_t>(n) : label[column];
        best[column] = std::min(best[column], distance);
      }
    }
  }
}

// Moves seeds to the means of their regions. Sums go down one column after another; a task has one of the five.
void move(const Lab& lab, const std::vector<int32_t>& labels, std::vector<Seed>& seeds) {
  std::vector<int> sizes(seeds.size());
  for (const int32_t label : labels) ++sizes[label];
  parallel_for(5, [&](int k) {
    std::vector<float> sums(seeds.size());
    for (int x = 0; x < lab.width; ++x)
      for (int y = 0; y < lab.height; ++y) {
        const size_t at = lab.at(x, y);
        sums[labels[at]] += k < 3 ? lab.values[k * lab.pixels() + at] : static_cast<float>(k == 3 ? x : y);
      }
    for (size_t n = 0; n < seeds.size(); ++n) seeds[n][k] = sums[n] / std::max(sizes[n], 1);
  });
}

// Numbers connected parts of regions from 0; a small part joins the one beside its first pixel.
std::vector<int32_t> connected(const Lab& lab, const std::vector<int32_t>& regions, size_t seeds) {
  const size_t least = std::max<size_t>(3, lab.pixels() / seeds / kSmallestPart);
  std::vector<int32_t> labels(lab.pixels(), -1);
  std::vector<std::pair<int, int>> part;
  int32_t next = 0, beside = 0;
  for (int row = 0; row < lab.height; ++row)
    for (int column = 0; column < lab.width; ++column) {
      const int32_t region = regions[lab.at(column, row)];
      if (labels[lab.at(column, row)] >= 0) continue;
      for (const auto& [dx, dy] : kBeside) {
        const int x = column + dx, y = row + dy;
        if (lab.has(x, y) && labels[lab.at(x, y)] >= 0) beside = labels[lab.at(x, y)];
      }
      labels[lab.at(column, row)] = next;
      part.assign(1, {column, row});
      for (size_t k = 0; k < part.size(); ++k)
        for (const auto& [dx, dy] : kBeside) {
          const int x = part[k].first + dx, y = part[k].second + dy;
          if (!lab.has(x, y) || labels[lab.at(x, y)] >= 0 || regions[lab.at(x, y)] != region) continue;
          labels[lab.at(x, y)] = next;
          part.emplace_back(x, y);
        }
      if (part.size() > least) ++next;
      else
        for (const auto& [x, y] : part) labels[lab.at(x, y)] = beside;
    }
  return labels;
}

}  // namespace

std::vector<int32_t> superpixels(const float* values, int width, int height, int side, float compactness) {
  const Lab lab{values, width, height};
  const float spacing = side / compactness * (side / compactness);
  std::vector<Seed> seeds = first_seeds(lab, side);
  std::vector<int32_t> regions(lab.pixels());
  for (int round = 0; round < kRounds; ++round) {
    parallel_chunks(height, kBand,
                    [&](int first, int last, int) { assign(lab, seeds, side, spacing, first, last, regions.data()); });
    move(lab, regions, seeds);
  }
  return connected(lab, regions, seeds.size());
}

}  // namespace sg
