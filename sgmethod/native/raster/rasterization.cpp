#include "raster/rasterization.h"

#include <algorithm>
#include <atomic>
#include <cmath>
#include <stdexcept>

#include "core/isa.h"
#include "core/thread_pool.h"
#include "raster/kernels.h"
#include "raster/levels.h"

namespace sg {
namespace {

constexpr int kChunk = 256;               // Gaussians of a task, at least
constexpr int kMaxBins = 64;
constexpr int kMaxGridSide = 1 << 20;     // pixels; the number of tiles stays within an int
constexpr int64_t kMaxReserve = 1 << 20;  // pairs for which a bin takes memory at once; boxes may promise far too many

// Gaussians in a bin. Each bin has a counter for every tile, so bins are few enough that going through their counters
// takes no longer than finding the pairs.
int bin_size(int n, int tiles) {
  const int64_t bins = std::clamp<int64_t>(int64_t{8} * n / tiles, 1, kMaxBins);
  return std::max(kChunk, static_cast<int>((n + bins - 1) / bins));
}

void require(bool condition, const char* message) {
  if (!condition) throw std::invalid_argument(message);
}

const Canvas& checked(const Canvas& canvas) {
  const auto fits = [](int place, int side) { return place >= 0 && place <= kMaxGridSide && side <= kMaxGridSide; };
  require(canvas.width > 0 && canvas.height > 0, "the image must have pixels");
  require(fits(canvas.x, canvas.width) && fits(canvas.y, canvas.height), "the image is too large");
  require(canvas.cutoff > 0 && canvas.cutoff <= kMaxCutoff, "the cutoff is out of range");
  return canvas;
}

int checked_isa(int isa) {
  const int best = best_isa();
  require(isa <= best, "this processor lacks the instruction set");
  return isa < 0 ? best : isa;
}

// At least the number of tiles that the box around an ellipse touches; NaN where it overflows.
float box_tiles(const float* l, float reach) {
  const float width = 2.0f * reach * l[0], height = 2.0f * reach * std::sqrt(l[1] * l[1] + l[2] * l[2]);
  return (width / kTileWidth + 2.1f) * (height / kTileHeight + 2.1f);
}

}  // namespace

Rasterization::Rasterization(const float* means, const float* factors, int n, const Canvas& canvas, int isa,
                             int64_t max_pairs)
    : canvas_(checked(canvas)), n_(n), isa_(checked_isa(isa)), reach_(std::sqrt(2.0f * canvas.cutoff)),
      floor_(exp_minus(canvas.cutoff)), footprints_(n), factors_(factors, factors + 3 * static_cast<int64_t>(n)), levels_(n) {
  place(means, factors);
  find_pairs(std::min(max_pairs, kMaxPairs));
  sort_pairs();
}

// Each Gaussian's level, and what it is in samples of it.
void Rasterization::place(const float* means, const float* factors) {
  std::atomic<int> top{0};
  if (canvas_.pyramid) original_ = factors_;
  parallel_chunks(n_, kChunk, [&](int first, int last, int) {
    int highest = 0;
    for (int64_t i = first; i < last; ++i) {
      const float *mean = means + 2 * i, *factor = factors + 3 * i;
      const int level = canvas_.pyramid ? level_of(factor) : 0;
      if (level == 0) {
        footprints_[i] = Footprint(mean, factor);
        continue;
      }
      const Levelled g(mean, factor, level);
      std::copy_n(g.factor, 3, &factors_[3 * i]);
      footprints_[i] = Footprint(g.mean, g.factor);
      footprints_[i].gain = g.gain;
      levels_[i] = static_cast<uint8_t>(level);
      highest = std::max(highest, level);
    }
    set_decays(&footprints_[first], last - first);
    for (int seen = top; seen < highest && !top.compare_exchange_weak(seen, highest);) {}
  });
  grids_ = grids_of(canvas_.x, canvas_.y, canvas_.width, canvas_.height, top);
  first_tile_.assign(1, 0);
  for (const Grid& grid : grids_) first_tile_.push_back(first_tile_.back() + grid.tiles());
}

void Rasterization::find_pairs(int64_t max_pairs) {
  chunk_ = bin_size(n_, tiles());
  bins_.resize((n_ + chunk_ - 1) / chunk_);
  std::atomic<int64_t> total{0};
  parallel_chunks(n_, chunk_, [&](int first, int last, int k) {
    int64_t sum = 0;
    for (int i = first; i < last; ++i)
      if (footprints_[i].segment != 0) {
        const auto most = static_cast<float>(tiles(levels_[i]));
        sum += static_cast<int64_t>(std::min(most, box_tiles(&factors_[3 * static_cast<int64_t>(i)], reach_)));
      }
    bins_[k].at_most = sum;
    total.fetch_add(sum, std::memory_order_relaxed);
  });
  if (total > max_pairs && pairs_up_to(max_pairs) > max_pairs)
    throw std::overflow_error("too many pairs of Gaussian and tile");
  parallel_chunks(n_, chunk_, [&](int first, int last, int k) {
    Bin& bin = bins_[k];
    bin.next.assign(tiles(), 0);
    bin.ends.reserve(last - first);
    bin.pairs.reserve(std::min(bin.at_most, kMaxReserve));
    bin.places.reserve(std::min(bin.at_most, kMaxReserve));
    for (int i = first; i < last; ++i) this->bin(i, bin);
  });
}

// A counting sort by tile. Bins come in order, so that each tile's Gaussians come in order of index.
void Rasterization::sort_pairs() {
  tile_start_.resize(tiles() + 1);
  int64_t total = 0;
  for (int tile = 0; tile < tiles(); ++tile) {
    tile_start_[tile] = total;
    for (Bin& bin : bins_) {
      const int32_t count = bin.next[tile];
      bin.next[tile] = static_cast<int32_t>(total);
      total += count;
    }
  }
  tile_start_[tiles()] = total;
  pairs_.reset(new Pair[total]);  // left unset: every place is written below
  parallel_for(static_cast<int>(bins_.size()), [&](int k) {
    Bin& bin = bins_[k];
    for (size_t i = 0; i < bin.pairs.size(); ++i) {
      int32_t& place = bin.places[i];
      place = bin.next[place]++;
      pairs_[place] = bin.pairs[i];
    }
    bin.pairs = {};
    bin.next = {};
  });
}

template <typename Visit>
int Rasterization::spans(int gaussian, const Visit& visit) const {
  const float* factor = factors_.data() + 3 * static_cast<int64_t>(gaussian);
  return sg::spans(footprints_[gaussian], factor, reach_, grids_[levels_[gaussian]], visit);
}

// The number of pairs, counted without memory and no further than the limit. A Gaussian counts as its strips where these
// are more than its pairs: looking at them takes time too.
int64_t Rasterization::pairs_up_to(int64_t limit) const {
  std::atomic<int64_t> total{0};
  parallel_chunks(n_, kChunk, [&](int first, int last, int) {
    for (int i = first; i < last && total.load(std::memory_order_relaxed) <= limit; ++i) {
      int64_t pairs = 0;
      const int strips =
          spans(i, [&](const Span& s) { pairs += s.last_row / kTileHeight - s.first_row / kTileHeight + 1; });
      total.fetch_add(std::max<int64_t>(pairs, strips), std::memory_order_relaxed);
    }
  });
  return total;
}

void Rasterization::bin(int gaussian, Bin& bin) const {
  const int level = levels_[gaussian], strips_across = grids_[level].strips();
  spans(gaussian, [&](const Span& span) {
    const int first = span.first_row / kTileHeight * kTileHeight;
    for (int base = first; base <= span.last_row; base += kTileHeight) {
      const int tile = first_tile_[level] + base / kTileHeight * strips_across + span.strip;
      bin.pairs.push_back({gaussian, static_cast<uint8_t>(std::max(span.first_row - base, 0)),
                           static_cast<uint8_t>(std::min(span.last_row - base, kTileHeight - 1)), span.first_lane,
                           span.last_lane});
      bin.places.push_back(tile);
      ++bin.next[tile];
    }
  });
  bin.ends.push_back(static_cast<int32_t>(bin.places.size()));
}

int Rasterization::level_of_tile(int tile) const {
  int level = 0;
  while (tile >= first_tile_[level + 1]) ++level;
  return level;
}

Rasterization::Corner Rasterization::corner(int tile) const {
  const int level = level_of_tile(tile), within = tile - first_tile_[level];
  const Grid& grid = grids_[level];
  return {grid.x + within % grid.strips() * kTileWidth, grid.y + within / grid.strips() * kTileHeight};
}

// In the order of each Gaussian's pairs, so that the sums are the same for every number of threads.
void Rasterization::sum_pairs(const float* colors, const float* pair_gradients, const Gradients& out) const {
  parallel_chunks(n_, chunk_, [&](int first, int last, int k) {
    const int32_t* place = bins_[k].places.data();
    for (int64_t i = first; i < last; ++i) {
      float sum[kPairGradients] = {};
      for (const int32_t* end = bins_[k].places.data() + bins_[k].ends[i - first]; place < end; ++place) {
        const float* gradient = pair_gradients + static_cast<int64_t>(*place) * kPairGradients;
        for (int j = 0; j < kPairGradients; ++j) sum[j] += gradient[j];
      }
      if (levels_[i] != 0) {
        const float* color = colors + 3 * i;
        const float by_gain = color[0] * sum[5] + color[1] * sum[6] + color[2] * sum[7];
        to_pixels(&original_[3 * i], levels_[i], by_gain, sum, sum + 2);
        for (int j = 5; j < kPairGradients; ++j) sum[j] *= footprints_[i].gain;
      }
      std::copy_n(sum, 2, out.means + 2 * i);
      std::copy_n(sum + 2, 3, out.factors + 3 * i);
      std::copy_n(sum + 5, 3, out.colors + 3 * i);
    }
  });
}

}  // namespace sg
