// A sweep visits every Gaussian once. Gaussians that share no pixels do not affect each other, so most of them are
// visited in parallel.
//
// The picture is divided into square cells, and a Gaussian belongs to the cell that contains its centre. A task visits
// the Gaussians of one cell in order. It may use the pixels of the cell and of a border around it, half a cell wide.
// These areas overlap for neighbouring cells. So a sweep has four phases, one for each combination of even or odd
// column and row: the cells of one phase lie two apart, and their areas only touch.
//
// If a Gaussian, or one of its candidates, needs pixels beyond the area of its cell, its task leaves it unchanged and
// the Gaussian waits. After the four phases the waiting ones are visited one by one, over the whole picture.
//
// The order of visits that share pixels is thus fixed, and the result does not depend on the number of threads.
#include "refine/refine.h"

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cmath>
#include <cstring>
#include <memory>
#include <numeric>

#include "core/errors.h"
#include "core/thread_pool.h"
#include "fit/gradients.h"
#include "refine/visitor.h"

namespace sg {
namespace {

constexpr double kConverged = 0.02;   // a sweep that changes a smaller share of the Gaussians is the last
constexpr int kCoarseSweeps = 2;
constexpr double kSmallExcess = 0.004;  // as a part of the payload
constexpr int kClockCheckInterval = 64;         // Gaussians between two readings of the clock
// Samples along a cell's side, half of which is a multiple of kTileWidth. Smaller on coarse levels, which would else be
// one cell.
constexpr int kCell = 128, kCoarseCell = 64;
constexpr int kFar = 1 << 24;  // beyond all strips and rows
using Clock = std::chrono::steady_clock;

class Refinement {
 public:
  Refinement(const RdParameters& p, std::vector<Symbols> all, const int16_t* target, const RefineSettings& settings)
      : target_(target), width_(halved(p.width, settings.halvings)), height_(halved(p.height, settings.halvings)),
        gram_(grids_of(0, 0, width_, height_, kMaxLevel), settings.visibility),
        state_{p, settings, exp_minus(kCutoffV2), std::sqrt(2.0f * kCutoffV2), {}, nullptr, gram_, nullptr, {}},
        all_(std::move(all)) {
    const int64_t width = width_, height = height_, strips = (width + kTileWidth - 1) / kTileWidth;
    floats_ = static_cast<size_t>(strips * height * 3 * kTileWidth);
    values_.reset(new float[floats_]);  // of which each redraw() sets all
    state_.residual = {values_.get(), width_, height_};
    if (settings.visibility == nullptr) return;
    visibility_.reset(new int16_t[strips * height * kTileWidth]);
    parallel_for(static_cast<int>(strips), [&](int strip) {
      const int64_t x = int64_t{strip} * kTileWidth, columns = std::min<int64_t>(kTileWidth, width - x);
      int16_t* to = &visibility_[strip * height * kTileWidth];
      for (int64_t y = 0; y < height; ++y, to += kTileWidth) {
        std::copy_n(settings.visibility + y * width + x, columns, to);
        std::fill(to + columns, to + kTileWidth, int16_t{0});
      }
    });
    state_.visibility = visibility_.get();
  }

  std::vector<uint8_t> run() {
    const std::chrono::duration<double> seconds(std::min(state_.settings.seconds, 1e6));
    until_ = Clock::now() + std::chrono::duration_cast<Clock::duration>(seconds);
    std::vector<uint8_t> payload = encode();
    for (int k = 0; k < state_.settings.sweeps; ++k)
      if (!sweep(k < kCoarseSweeps, payload)) break;
    if (drop_until_it_fits(payload)) {
      sweep(true, payload);  // lets the remaining Gaussians make up for those dropped
      drop_until_it_fits(payload);
    }
    return payload;
  }

 private:
  bool is_late() const { return Clock::now() >= until_; }

  // Returns whether another sweep may gain more. coarse: includes coarse levels, whose few Gaussians converge early.
  bool sweep(bool coarse, std::vector<uint8_t>& payload) {
    if (is_late()) return false;
    const size_t changed = visit_everywhere(coarse);
    payload = encode();
    return changed >= all_.size() * kConverged;
  }

  // Draws the picture, and sets the residual.
  void redraw() {
    drawn_ = all_;
    GaussianArrays g;
    levels_ = decode(all_, g);
    const Rasterization raster = rasterised(g);
    reduced_.reset();  // frees a third of a picture before the next is allocated
    reduced_ = std::make_unique<Planes>(raster.grids());
    state_.reduced = reduced_.get();
    draw_residual(raster, g.colors.data(), target_, state_.residual, *reduced_, state_.settings.visibility);
  }

  // Updates the residual of a level for changes on levels above it since redraw(), which is less work than to draw
  // again. The picture's residual, which redraw() will have to set, gives its memory to that.
  void update_residual(int level) {
    std::vector<Symbols> changed, now;
    for (size_t i = 0; i < all_.size(); ++i) {
      if (levels_[i] <= level || std::memcmp(&drawn_[i], &all_[i], sizeof all_[i]) == 0) continue;
      changed.push_back(drawn_[i]);
      now.push_back(all_[i]);
    }
    const size_t before = changed.size();
    changed.insert(changed.end(), now.begin(), now.end());
    GaussianArrays g;
    decode(changed, g);
    for (size_t i = 3 * before; i < g.colors.size(); ++i) g.colors[i] = -g.colors[i];
    const Rasterization raster = rasterised(g);
    Planes picture(raster.grids(), Planes::Rows::kWhole, level, values_.get(), floats_);
    raster.draw_coarse(g.colors.data(), level, picture);
    gram_.add(level, picture, *reduced_);
  }

  // Sets g to the Gaussians of symbols, in samples of the target, and returns their levels.
  std::vector<int> decode(const std::vector<Symbols>& symbols, GaussianArrays& g) const {
    const size_t n = symbols.size();
    g = {std::vector<float>(2 * n), std::vector<float>(3 * n), std::vector<float>(3 * n)};
    std::vector<int> levels(n);
    parallel_each(static_cast<int>(n), kClockCheckInterval, [&](int64_t i) {
      const Candidate c = state_.decoded(symbols[i]);
      std::copy_n(c.place, 2, &g.means[2 * i]);
      std::copy_n(c.shape, 3, &g.factors[3 * i]);
      std::copy_n(c.color, 3, &g.colors[3 * i]);
      levels[i] = c.level;
    });
    return levels;
  }

  Rasterization rasterised(const GaussianArrays& g) const {
    const Canvas canvas{0, 0, width_, height_, kCutoffV2, true};
    return Rasterization(g.means.data(), g.factors.data(), g.count(), canvas, -1, kMaxPairs);
  }

  // Visits all Gaussians once, level by level from the top. Returns the number of changed ones.
  size_t visit_everywhere(bool coarse) {
    redraw();
    std::vector<std::vector<size_t>> waiting(static_cast<size_t>(reduced_->top()) + 1);
    for (size_t i = 0; i < all_.size(); ++i) waiting[static_cast<size_t>(levels_[i])].push_back(i);
    size_t changed = 0;
    for (int level = coarse ? reduced_->top() : 0; level >= 0; --level) {
      std::vector<size_t>& here = waiting[static_cast<size_t>(level)];
      if (here.empty()) continue;
      if (changed != 0) level == 0 ? redraw() : update_residual(level);
      changed += visit_cells(level, here);
      changed += visit_all(whole(), here);
    }
    return changed;
  }

  // The four phases on one level. Visits the Gaussians in `waiting`, and leaves there those that still have to wait.
  size_t visit_cells(int level, std::vector<size_t>& waiting) {
    const Grid& grid = reduced_->grid(level);
    const int side = level == 0 ? kCell : kCoarseCell, half = side / 2;
    const int columns = (grid.width + side - 1) / side, rows = (grid.height + side - 1) / side;
    if (columns * rows == 1) return 0;
    const float samples = std::ldexp(1.0f, -level);
    std::vector<std::vector<size_t>> cells(static_cast<size_t>(columns) * rows);
    std::vector<size_t> cell_of(waiting.size());
    parallel_each(static_cast<int>(waiting.size()), kClockCheckInterval, [&](int k) {
      const Candidate c = state_.decoded(all_[waiting[k]]);
      const int column = std::clamp(static_cast<int>(c.place[0] * samples / side), 0, columns - 1);
      const int row = std::clamp(static_cast<int>(c.place[1] * samples / side), 0, rows - 1);
      cell_of[k] = static_cast<size_t>(row) * columns + column;
    });
    for (size_t k = 0; k < waiting.size(); ++k) cells[cell_of[k]].push_back(waiting[k]);
    std::atomic<size_t> changed{0};
    for (int phase = 0; phase < 4; ++phase) {
      const int column0 = phase % 2, row0 = phase / 2, across = (columns - column0 + 1) / 2;
      parallel_for(across * ((rows - row0 + 1) / 2), [&](int k) {
        const int column = column0 + k % across * 2, row = row0 + k / across * 2;
        const Part part{(2 * column - 1) * half / kTileWidth, (2 * column + 3) * half / kTileWidth,
                        (2 * row - 1) * half, (2 * row + 3) * half};
        changed += visit_all(part, cells[static_cast<size_t>(row) * columns + column]);
      });
    }
    waiting.clear();
    for (const auto& cell : cells) waiting.insert(waiting.end(), cell.begin(), cell.end());
    std::sort(waiting.begin(), waiting.end());
    return changed;
  }

  // Visits the Gaussians in `waiting` that stay within a part of the picture, and leaves the others there. Returns the
  // number of changed ones.
  size_t visit_all(const Part& part, std::vector<size_t>& waiting) {
    Visitor visitor(state_, part);
    size_t changed = 0, still_waiting = 0;
    for (size_t k = 0; k < waiting.size() && (k % kClockCheckInterval != 0 || Clock::now() < until_); ++k) {
      const Outcome outcome = visitor.visit(all_[waiting[k]]);
      if (outcome == Outcome::kOutside) waiting[still_waiting++] = waiting[k];
      changed += outcome == Outcome::kChanged;
    }
    waiting.resize(still_waiting);
    return changed;
  }

  static Part whole() { return {-kFar, kFar, -kFar, kFar}; }

  std::vector<uint8_t> encode() {
    erase_empty(all_);
    state_.models = Models();
    return encode_symbols(state_.p, all_, state_.models);
  }

  // Drops Gaussians until the payload has at most max_bytes. Returns whether any were dropped.
  bool drop_until_it_fits(std::vector<uint8_t>& payload) {
    bool dropped = false;
    for (; payload.size() > state_.settings.max_bytes && !all_.empty(); dropped = true) drop_least(payload);
    return dropped;
  }

  // Drops Gaussians, beginning with those that lower the error least for each of their bits, until the payload fits.
  // The neighbours of dropped ones gain in worth, so the order becomes stale: unless the excess is small, or time is
  // over, this stops after one round, to be called again.
  void drop_least(std::vector<uint8_t>& payload) {
    redraw();
    std::vector<std::pair<double, size_t>> order(all_.size());
    std::vector<double> sizes(all_.size());
    parallel_chunks(static_cast<int>(all_.size()), kClockCheckInterval, [&](int first, int last, int) {
      Visitor visitor(state_, whole());
      for (int i = first; i < last; ++i) {
        const Candidate c = state_.decoded(all_[i]);
        float products[4];
        visitor.project(c, products);
        const double loss = state_.change(c, products, 2.0);
        sizes[i] = state_.bits(c.symbols);
        order[i] = {loss / sizes[i], static_cast<size_t>(i)};
      }
    });
    std::sort(order.begin(), order.end());
    std::vector<Symbols> staying = all_;
    size_t next = 0;
    const auto limit = static_cast<double>(state_.settings.max_bytes);
    const auto excess = [&] { return static_cast<double>(payload.size()) - limit; };
    do {
      double bits = (is_late() ? 1.0 : 0.6) * 8.0 * excess();  // less, because the sizes are estimates
      for (; next < order.size() && bits > 0; ++next) {
        Symbols& s = staying[order[next].second];
        bits -= sizes[order[next].second];
        s.y = s.a = s.b = 0;
      }
      all_ = staying;
      payload = encode();
    } while (next < order.size() && excess() > 0 && (is_late() || excess() < kSmallExcess * payload.size()));
  }

  const int16_t* target_;
  const int width_, height_;  // of the target
  const Gram gram_;
  State state_;
  std::vector<Symbols> all_;
  std::vector<Symbols> drawn_;  // all_ at the last redraw()
  size_t floats_ = 0;
  std::unique_ptr<float[]> values_;  // [floats_] memory of state_.residual
  std::unique_ptr<int16_t[]> visibility_;  // memory of state_.visibility
  std::unique_ptr<Planes> reduced_;
  std::vector<int> levels_;  // of all_ at the last redraw()
  Clock::time_point until_;
};

}  // namespace

std::vector<uint8_t> rd_refine(const RdParameters& p, const ConstGaussians& gaussians, int n, const int16_t* target,
                               const RefineSettings& settings) {
  return Refinement(p, quantised(p, gaussians, n), target, settings).run();
}

}  // namespace sg
