#include "raster/rasterization.h"

#include <algorithm>
#include <atomic>
#include <cmath>

#include "core/errors.h"
#include "core/isa.h"
#include "core/thread_pool.h"
#include "raster/crossings.h"
#include "raster/kernels.h"
#include "raster/levels.h"

namespace sg {
namespace {

constexpr int kChunk = 256;               // Gaussians of a bin, at least
constexpr int kMaxBins = 64;
constexpr int kMaxGridSide = 1 << 20;     // pixels; the number of tiles stays within an int
constexpr int kPairsExpected = 4;         // of a Gaussian; a bin takes memory for so many at once
constexpr char kTooManyPairs[] = "too many pairs of Gaussian and tile";
constexpr int64_t kPairsAtOnce = 1 << 20; // more are counted before they take memory: there may be far too many

// Gaussians in a bin. Each bin has a counter for every tile, so bins are few enough that going through their counters
// takes no longer than finding the pairs.
int bin_size(int n, int tiles) {
  const int64_t bins = std::clamp<int64_t>(int64_t{8} * n / tiles, 1, kMaxBins);
  return std::max(kChunk, static_cast<int>((n + bins - 1) / bins));
}

void require(bool condition, const char* message) {
  if (!condition) refuse<std::invalid_argument>(message);
}

const Canvas& checked(const Canvas& canvas) {
  const auto fits = [](int place, int side) { return place >= 0 && place <= kMaxGridSide && side <= kMaxGridSide; };
  require(canvas.width > 0 && canvas.height > 0, "the image must have pixels");
  require(fits(canvas.x, canvas.width) && fits(canvas.y, canvas.height), "the image is too large");
  require(canvas.cutoff > 0 && canvas.cutoff <= kMaxCutoff, "the cutoff is out of range");
  require(canvas.texture == nullptr || canvas.pyramid, "texture is drawn in a pyramid alone");
  return canvas;
}

int checked_isa(int isa) {
  const int best = best_isa();
  require(isa <= best, "this processor lacks the instruction set");
  return isa < 0 ? best : isa;
}

}  // namespace

int64_t most_pairs(int n, int width, int height) {
  const Grid grid{0, 0, width, height};
  return 16 * int64_t{n} + 256 * int64_t{grid.strips()} * grid.blocks();
}

Rasterization::Rasterization(const Canvas& canvas, int isa, int n)
    : canvas_(checked(canvas)), n_(n), isa_(checked_isa(isa)), reach_(std::sqrt(2.0f * canvas.cutoff)),
      floor_(exp_minus(canvas.cutoff)), footprints_(n), levels_(n) {}

Rasterization::Rasterization(const float* means, const float* factors, int n, const Canvas& canvas, int isa,
                             int64_t max_pairs)
    : Rasterization(canvas, isa, n) {
  factors_.assign(factors, factors + 3 * static_cast<int64_t>(n));
  lay_out(means, max_pairs);
  sort_pairs();
  set_textures();
}

Rasterization::Rasterization(const Arrivals& arrivals, const Canvas& canvas, int isa)
    : Rasterization(canvas, isa, arrivals.room) {
  factors_.resize(3 * static_cast<size_t>(n_));
  const int64_t pairs = find_pairs(arrivals.means, kPairsAtOnce, kPairsAtOnce, [&](const Chunk& body) {
    n_ = parallel_while(chunk_, arrivals.bring, [&](int first, int last, int k) {
      std::copy(arrivals.factors + 3 * int64_t{first}, arrivals.factors + 3 * int64_t{last}, &factors_[3 * size_t(first)]);
      body(first, last, k);
    });
  });
  footprints_.resize(n_);
  factors_.resize(3 * static_cast<size_t>(n_));
  levels_.resize(n_);
  bins_.resize((n_ + chunk_ - 1) / chunk_);
  const int64_t most = most_pairs(n_, width(), height());
  if (pairs > kPairsAtOnce) lay_out(arrivals.means, most);
  else if (pairs > most) refuse<std::overflow_error>(kTooManyPairs);
  sort_pairs();
  set_textures();
}

void Rasterization::lay_out(const float* means, int64_t max_pairs) {
  max_pairs = std::min(max_pairs, kMaxPairs);
  const auto each_chunk = [this](const Chunk& body) { parallel_chunks(n_, chunk_, body); };
  const int64_t pairs = find_pairs(means, max_pairs, std::min(max_pairs, kPairsAtOnce), each_chunk);
  if (pairs > max_pairs) refuse<std::overflow_error>(kTooManyPairs);
  if (pairs > kPairsAtOnce) find_pairs(means, max_pairs, max_pairs, each_chunk);
}

void Rasterization::set_textures() {
  if (canvas_.texture == nullptr) return;
  for (int level = 0; level <= top(); ++level) {
    const Grid& grid = grids_[level];
    const int border = border_of(level);
    texture_.emplace_back(*canvas_.texture, level, grid.x - border, grid.y - border, grid.strips() * kTileWidth, grid.height);
  }
}

Rasterization::Bin::Bin(int first_gaussian, int end, int tiles) : first(first_gaussian), counts(end - first), next(tiles) {
  pairs.reserve(kPairsExpected * counts.size());
  places.reserve(kPairsExpected * counts.size());
}

void Rasterization::set_levels(int top) {
  grids_ = grids_of(canvas_.x, canvas_.y, canvas_.width, canvas_.height, top);
  first_tile_.assign(1, 0);
  for (const Grid& grid : grids_) first_tile_.push_back(first_tile_.back() + grid.tiles());
}

// Prepares each Gaussian, and finds the tiles that it touches. Levels above the highest that a Gaussian has come last, so
// that their tiles can be left out at the end. Returns the number of pairs, counted no further than the limit; beyond
// most_kept they are counted alone.
int64_t Rasterization::find_pairs(const float* means, int64_t limit, int64_t most_kept, const EachChunk& each_chunk) {
  set_levels(canvas_.pyramid ? kMaxLevel : 0);
  chunk_ = bin_size(n_, tiles());
  bins_.resize((n_ + chunk_ - 1) / chunk_);
  std::atomic<int> top{canvas_.texture == nullptr ? 0 : std::max(canvas_.texture->top(), 0)};
  std::atomic<int64_t> total{0};
  each_chunk([&](int first, int last, int k) {
    bins_[k] = Bin(first, last, tiles());
    Crossings<kManyStrips> crossings;
    const auto count = [&] {
      const int64_t found = this->count(crossings), before = total.fetch_add(found, std::memory_order_relaxed);
      if (before + found <= most_kept) bin(crossings, bins_[k]);
      crossings.count = 0;
      return before + found;
    };
    int highest = 0;
    for (int i = first; i < last; ++i) {
      const Ellipse ellipse = place(i, means + 2 * static_cast<int64_t>(i));
      if (footprints_[i].segment == 0) continue;
      const Grid& grid = grids_[levels_[i]];
      highest = std::max(highest, int{levels_[i]});
      for (int strip = ellipse.first_strip(grid), end = ellipse.last_strip(grid); strip <= end; ++strip) {
        crossings.add(i, strip, ellipse, grid);
        if (crossings.count == kManyStrips && count() > limit) return;
      }
    }
    count();
    set_decays(&footprints_[first], last - first);
    for (int seen = top; seen < highest && !top.compare_exchange_weak(seen, highest);) {}
  });
  set_levels(top);
  return total;
}

// A Gaussian's level, and what it is in samples of it.
Ellipse Rasterization::place(int gaussian, const float* mean) {
  const float* factor = &factors_[3 * static_cast<int64_t>(gaussian)];
  Footprint& f = footprints_[gaussian];
  const int level = canvas_.pyramid ? level_of(factor) : 0;
  if (level == 0) {
    f = Footprint(mean, factor);
    return f.segment == 0 ? Ellipse{} : Ellipse(f, factor, reach_);
  }
  const Levelled g(mean, factor, level);
  f = Footprint(g.mean, g.factor);
  f.gain = g.gain;
  levels_[gaussian] = static_cast<uint8_t>(level);
  return f.segment == 0 ? Ellipse{} : Ellipse(f, g.factor, reach_);
}

// Finds where ellipses cross, and returns the number of pairs. An empty strip counts too: looking at it takes time.
int64_t Rasterization::count(Crossings<kManyStrips>& c) const {
  kernels(isa_).cross(c, reach_);
  int64_t pairs = 0;
  for (int k = 0; k < c.count; ++k) pairs += std::max(c.blocks(k), 1);
  return pairs;
}

void Rasterization::bin(const Crossings<kManyStrips>& c, Bin& bin) const {
  int64_t pairs = 0;
  for (int k = 0; k < c.count; ++k) pairs += c.blocks(k);
  const size_t before = bin.places.size();
  bin.pairs.resize(before + pairs);
  bin.places.resize(before + pairs);
  Pair* pair = bin.pairs.data() + before;
  int32_t *place = bin.places.data() + before, *next = bin.next.data();
  for (int k = 0; k < c.count; ++k) {
    const int level = levels_[c.gaussian[k]], blocks = c.blocks(k);
    const Grid& grid = grids_[level];
    const int first_row = c.first_row[k] - grid.y, last_row = c.last_row[k] - grid.y, across = grid.strips();
    const int top = first_row / kTileHeight;
    int tile = first_tile_[level] + top * across + c.strip[k] - grid.x / kTileWidth;
    bin.counts[c.gaussian[k] - bin.first] += blocks;
    for (int block = top; block < top + blocks; ++block, tile += across) {
      const int base = block * kTileHeight;
      *pair++ = {c.gaussian[k], static_cast<uint8_t>(std::max(first_row - base, 0)),
                 static_cast<uint8_t>(std::min(last_row - base, kTileHeight - 1)), static_cast<uint8_t>(c.first_lane[k]),
                 static_cast<uint8_t>(c.last_lane[k])};
      *place++ = tile;
      ++next[tile];
    }
  }
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
      for (const int32_t* end = place + bins_[k].counts[i - first]; place < end; ++place) {
        const float* gradient = pair_gradients + static_cast<int64_t>(*place) * kPairGradients;
        for (int j = 0; j < kPairGradients; ++j) sum[j] += gradient[j];
      }
      if (levels_[i] != 0) {
        const float* color = colors + 3 * i;
        const float by_gain = color[0] * sum[5] + color[1] * sum[6] + color[2] * sum[7];
        to_pixels(&factors_[3 * i], levels_[i], by_gain, sum, sum + 2);
        for (int j = 5; j < kPairGradients; ++j) sum[j] *= footprints_[i].gain;
      }
      std::copy_n(sum, 2, out.means + 2 * i);
      std::copy_n(sum + 2, 3, out.factors + 3 * i);
      std::copy_n(sum + 5, 3, out.colors + 3 * i);
    }
  });
}

}  // namespace sg
