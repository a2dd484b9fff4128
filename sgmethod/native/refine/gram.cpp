#include "refine/gram.h"

#include <algorithm>
#include <cmath>

#include "core/isa.h"
#include "core/platform.h"
#include "core/scratch.h"
#include "core/thread_pool.h"
#include "raster/levels.h"

namespace sg {
namespace {

constexpr int kRowsTogether = 32;
constexpr int kLanes = 16;  // partial sums, so that their order does not depend on the instruction set

using Rows = const float* const[Patch::kTaps];

// out = weighted sum of five rows, or of one row at five offsets.
SG_CLONES void weighted_sum(const Rows& in, const Rows& weights, float* out, int count) {
  for (int i = 0; i < count; ++i)
    out[i] = weights[0][i] * in[0][i] + weights[1][i] * in[1][i] + weights[2][i] * in[2][i] + weights[3][i] * in[3][i] +
             weights[4][i] * in[4][i];
}

SG_CLONES void weighted_sum(const Rows& in, const float (&weights)[Patch::kTaps], float* out, int count) {
  const float w0 = weights[0], w1 = weights[1], w2 = weights[2], w3 = weights[3], w4 = weights[4];
  for (int i = 0; i < count; ++i)
    out[i] = w0 * in[0][i] + w1 * in[1][i] + w2 * in[2][i] + w3 * in[3][i] + w4 * in[4][i];
}

SG_CLONES void add_products(const float* a, const float* b, int count, float (&partial)[kLanes]) {
  for (int i = 0; i < count; i += kLanes)
    for (int k = 0; k < kLanes; ++k) partial[k] += a[i + k] * b[i + k];
}

SG_CLONES void add_scaled(const float* in, float scale, int count, float* out) {
  for (int i = 0; i < count; ++i) out[i] += scale * in[i];
}

float total(const float (&partial)[kLanes]) {
  float sum = 0;
  for (float p : partial) sum += p;
  return sum;
}

}  // namespace

void Patch::draw(const Footprint& f, float floor, const std::vector<Span>& spans) {
  int first = spans[0].first_row, last = spans[0].last_row;
  x_ = spans.front().strip * kTileWidth - kMarginColumns;
  columns_ = (spans.back().strip - spans.front().strip + 1) * kTileWidth + 2 * kMarginColumns;
  begin_ = columns_;
  end_ = 0;
  for (const Span& span : spans) {
    first = std::min(first, span.first_row);
    last = std::max(last, span.last_row);
    const int column = span.strip * kTileWidth - x_;
    begin_ = std::min(begin_, column + span.first_lane - kMarginRows);
    end_ = std::max(end_, column + span.last_lane + 1 + kMarginRows);
  }
  y_ = first - kMarginRows;
  rows_ = last - first + 1 + 2 * kMarginRows;
  weights_.assign(static_cast<size_t>(rows_) * columns_, 0.0f);
  const int count = static_cast<int>(spans.size());
  float* const from = weights(kMarginRows) + kMarginColumns;
  fit_kernels(best_isa()).weights(f, floor, spans.data(), count, first, columns_, from);
}

// Computed level by level: fine samples i and j that both lie in the picture each come from two coarse ones, near and
// far.
std::vector<Gram::Band> Gram::bands(const std::vector<int>& sizes) {
  std::vector<Band> all;
  for (size_t level = 0; level < sizes.size(); ++level) {
    Band band(sizes[level]);
    if (level == 0) {
      for (int i = 0; i < sizes[0]; ++i) *band.at(2, i) = 1.0f;
      all.push_back(std::move(band));
      continue;
    }
    const int fine_level = static_cast<int>(level) - 1;
    for (int i = 0; i < sizes[level - 1]; ++i)
      for (int tap = 0; tap < Patch::kTaps; ++tap) {
        const int j = i + tap - 2;
        if (j < 0 || j >= sizes[level - 1]) continue;
        const float value = *all.back().at(tap, i);
        const auto far = [&](int fine) { return coarse_of(fine, fine_level) + (fine % 2 == 0 ? 0 : 2); };
        const auto near = [&](int fine) { return coarse_of(fine, fine_level) + 1; };
        const auto give = [&](int a, int b, float share) { *band.at(b - a + 2, a) += share * value; };
        give(near(i), near(j), 0.5625f);
        give(near(i), far(j), 0.1875f);
        give(far(i), near(j), 0.1875f);
        give(far(i), far(j), 0.0625f);
      }
    all.push_back(std::move(band));
  }
  return all;
}

// A sample of level l is as wide as two of level l - 1. Samples beyond the picture have the visibility of the nearest
// one within.
void Gram::set_roots(const std::vector<Grid>& grids, const int16_t* visibility) {
  std::vector<float> finer;  // visibility on the previous level
  roots_.resize(grids.size());
  for (size_t level = 1; level < grids.size(); ++level) {
    const Grid &grid = grids[level], &below = grids[level - 1];
    std::vector<float> here(static_cast<size_t>(grid.width) * grid.height);
    const int border = level == 1 ? 2 * kBorder : kBorder;
    const auto mean = [&](int x, int y) {
      float sum = 0;
      for (int k = 0; k < 4; ++k) {
        const int column = std::clamp(2 * x - border + k % 2, 0, below.width - 1);
        const int row = std::clamp(2 * y - border + k / 2, 0, below.height - 1);
        const size_t at = static_cast<size_t>(row) * below.width + column;
        sum += level == 1 ? static_cast<float>(visibility[at]) / kVisible : finer[at];
      }
      return 0.25f * sum;
    };
    parallel_each(grid.height, kRowsTogether, [&](int y) {
      for (int x = 0; x < grid.width; ++x) here[static_cast<size_t>(y) * grid.width + x] = mean(x, y);
    });
    Roots& roots = roots_[level];
    roots.stride = grid.width + 2 * kPad;
    roots.rows = grid.height;
    roots.values.resize(static_cast<size_t>(roots.stride) * roots.rows);
    parallel_each(grid.height, kRowsTogether, [&](int y) {
      for (int x = 0; x < roots.stride; ++x)
        roots.values[static_cast<size_t>(y) * roots.stride + x] =
            std::sqrt(here[static_cast<size_t>(y) * grid.width + std::clamp(x - kPad, 0, grid.width - 1)]);
    });
    finer = std::move(here);
  }
}

Gram::Gram(const std::vector<Grid>& grids, const int16_t* visibility) {
  if (visibility != nullptr) set_roots(grids, visibility);
  std::vector<int> widths, heights;
  for (const Grid& grid : grids) {
    widths.push_back(grid.width);
    heights.push_back(grid.height);
  }
  across_ = bands(widths);
  down_ = bands(heights);
}

void Gram::apply(int level, Patch& patch) const {
  constexpr int kRows = Patch::kMarginRows;
  const Band &across = across_[static_cast<size_t>(level)], &down = down_[static_cast<size_t>(level)];
  const int columns = patch.columns_, used = columns - 4;
  patch.half_.assign(patch.weights_.size(), 0.0f);
  patch.product_.assign(patch.weights_.size(), 0.0f);
  const auto half = [&](int row) { return patch.half_.data() + static_cast<size_t>(row) * columns; };
  for (int row = kRows; row < patch.rows_ - kRows; ++row) {
    const float* in = patch.weights(row);
    if (!roots_.empty()) {
      const float* root = roots_[static_cast<size_t>(level)].row(patch.x_, patch.y_ + row);
      patch.seen_.resize(static_cast<size_t>(columns));
      for (int i = 0; i < columns; ++i) patch.seen_[i] = in[i] * root[i];
      in = patch.seen_.data();
    }
    const float* const moved[] = {in, in + 1, in + 2, in + 3, in + 4};
    const int x = patch.x_ + 2;
    const float* const taps[] = {across.at(0, x), across.at(1, x), across.at(2, x), across.at(3, x), across.at(4, x)};
    weighted_sum(moved, taps, half(row) + 2, used);
  }
  for (int row = 0; row < patch.rows_; ++row) {
    const auto near = [&](int tap) { return half(std::clamp(row + tap - 2, 0, patch.rows_ - 1)); };
    const auto tap = [&](int k) {
      const bool within = row + k - 2 >= 0 && row + k - 2 < patch.rows_;
      return within ? *down.at(k, patch.y_ + row) : 0.0f;
    };
    const float* const rows[] = {near(0), near(1), near(2), near(3), near(4)};
    const float taps[] = {tap(0), tap(1), tap(2), tap(3), tap(4)};
    float* product = patch.product_.data() + static_cast<size_t>(row) * columns;
    weighted_sum(rows, taps, product, columns);
    if (roots_.empty()) continue;
    const float* root = roots_[static_cast<size_t>(level)].row(patch.x_, patch.y_ + row);
    for (int i = 0; i < columns; ++i) product[i] *= root[i];
  }
}

void Gram::add(int level, Planes& picture, Planes& reduced) const {
  constexpr int kTaps = Patch::kTaps, kReach = kTaps / 2;
  constexpr float kDrawn = 16.0f;  // levels are drawn divided by 16
  const Grid& grid = picture.grid(level);
  const Band &across = across_[static_cast<size_t>(level)], &down = down_[static_cast<size_t>(level)];
  const size_t width = static_cast<size_t>(grid.width);
  const auto root_of = [&](int y) { return roots_.empty() ? nullptr : roots_[static_cast<size_t>(level)].row(0, y); };
  // Along the rows, then down the columns, of some rows and those around them: the level's would be a large picture.
  parallel_chunks(grid.height, kRowsTogether, [&](int first, int end, int) {
    const int top = std::max(first - kReach, 0), bottom = std::min(end + kReach, grid.height);
    std::vector<float> halves(3 * width * static_cast<size_t>(bottom - top));
    std::vector<float> row(width + 2 * kReach);  // zeros at both ends
    std::vector<float> sum(width);
    const auto half = [&](int y, int color) { return &halves[(static_cast<size_t>(y - top) * 3 + color) * width]; };
    for (int y = top; y < bottom; ++y)
      for (int color = 0; color < 3; ++color) {
        const float *const root = root_of(y), *from = picture.at(level, 0, y) + color * picture.stride(level);
        for (size_t x = 0; x < width; ++x) row[x + kReach] = kDrawn * from[x] * (root == nullptr ? 1.0f : root[x]);
        const float* const moved[] = {&row[0], &row[1], &row[2], &row[3], &row[4]};
        const float* const taps[] = {across.at(0, 0), across.at(1, 0), across.at(2, 0), across.at(3, 0),
                                     across.at(4, 0)};
        weighted_sum(moved, taps, half(y, color), grid.width);
      }
    for (int y = first; y < end; ++y)
      for (int color = 0; color < 3; ++color) {
        const float *const root = root_of(y), *rows[kTaps];
        float taps[kTaps];
        for (int k = 0; k < kTaps; ++k) {
          const int from = y + k - kReach;
          const bool within = from >= 0 && from < grid.height;
          rows[k] = half(within ? from : y, color);
          taps[k] = within ? *down.at(k, y) : 0.0f;
        }
        weighted_sum(rows, taps, sum.data(), grid.width);
        float* to = reduced.at(level, 0, y) + color * reduced.stride(level);
        for (size_t x = 0; x < width; ++x) to[x] += sum[x] * (root == nullptr ? 1.0f : root[x]);
      }
  });
}

void Gram::project(const Patch& patch, int level, Planes& reduced, float* sums) {
  constexpr int kRows = Patch::kMarginRows, kColumns = Patch::kMarginColumns;
  float partial[4][kLanes] = {};
  const int count = patch.columns_ - 2 * kColumns;
  for (int row = kRows; row < patch.rows_ - kRows; ++row) {
    const float* weights = patch.weights(row) + kColumns;
    const float* values = reduced.at(level, patch.x_ + kColumns, patch.y_ + row);
    for (int k = 0; k < 3; ++k) add_products(weights, values + k * reduced.stride(level), count, partial[k]);
    add_products(weights, patch.product(row) + kColumns, count, partial[3]);
  }
  for (int k = 0; k < 4; ++k) sums[k] = total(partial[k]);
}

void Gram::add(const Patch& patch, int level, const float* color, Planes& reduced) {
  const Grid& grid = reduced.grid(level);
  const int left = std::max(grid.x, patch.x_ + patch.begin_);
  const int right = std::min(grid.x + grid.width, patch.x_ + patch.end_);
  const int top = std::max(grid.y - patch.y_, 0), bottom = std::min(patch.rows_, grid.y + grid.height - patch.y_);
  for (int row = top; row < bottom; ++row)
    for (int k = 0; k < 3; ++k)
      add_scaled(patch.product(row) + left - patch.x_, color[k], right - left,
                 reduced.at(level, left, patch.y_ + row) + k * reduced.stride(level));
}

}  // namespace sg
