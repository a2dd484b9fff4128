#include "raster/rasterization.h"

#include <algorithm>
#include <atomic>
#include <cmath>
#include <cstring>
#include <utility>

#include "core/errors.h"
#include "core/isa.h"
#include "core/thread_pool.h"
#include "raster/kernels.h"
#include "raster/levels.h"

namespace sg {
namespace {

constexpr int kChunk = 256;               // least Gaussians in a bin
constexpr int kMaxBins = 64;
constexpr int kMaxGridSide = 1 << 20;     // pixels; the number of tiles stays within an int
constexpr int kPairsExpected = 4;         // per Gaussian; a bin allocates for this many at once
constexpr char kTooManyPairs[] = "too many pairs of Gaussian and tile";
constexpr int kTilesTogether = 1024;      // counted by one task
constexpr int64_t kPairsAtOnce = 1 << 20; // more are counted before memory is taken: there may be far too many

// Gaussians in a bin. Each bin has a counter for every tile, so there must be few bins: summing their counters should
// take no longer than finding the pairs.
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

int64_t max_pairs_of(int n, int width, int height) {
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

Rasterization::Rasterization(const StreamedGaussians& stream, const Canvas& canvas)
    : Rasterization(canvas, -1, stream.limit) {
  factors_.resize(3 * static_cast<size_t>(n_));
  const std::unique_ptr<float[]> means(new float[2 * static_cast<size_t>(n_)]);
  const int64_t pairs = find_pairs(means.get(), kPairsAtOnce, kPairsAtOnce, [&](const Chunk& body) {
    n_ = parallel_while(chunk_, stream.bring, [&](int first, int last, int k) {
      stream.values(first, last, &means[2 * static_cast<size_t>(first)], &factors_[3 * static_cast<size_t>(first)]);
      body(first, last, k);
    });
  });
  footprints_.resize(n_);
  factors_.resize(3 * static_cast<size_t>(n_));
  levels_.resize(n_);
  bins_.resize((n_ + chunk_ - 1) / chunk_);
  const int64_t max_pairs = max_pairs_of(n_, width(), height());
  if (pairs > kPairsAtOnce) lay_out(means.get(), max_pairs);
  else if (pairs > max_pairs) refuse<std::overflow_error>(kTooManyPairs);
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
    texture_.emplace_back(*canvas_.texture, level, grid.x - border, grid.y - border, grid.strips() * kTileWidth,
                          grid.height);
  }
}

Rasterization::Bin::Bin(int first_gaussian, int end, int tiles)
    : first(first_gaussian), counts(end - first), next(tiles) {
  pairs.reserve(kPairsExpected * counts.size());
  places.reserve(kPairsExpected * counts.size());
}

void Rasterization::set_levels(int top) {
  grids_ = grids_of(canvas_.x, canvas_.y, canvas_.width, canvas_.height, top);
  first_tile_.assign(1, 0);
  for (const Grid& grid : grids_) first_tile_.push_back(first_tile_.back() + grid.tiles());
}

// Prepares each Gaussian, and finds the tiles that it touches. Tiles of coarser levels come last, so that those of
// unused levels can be dropped at the end. Returns the number of pairs, counted up to about the limit; pairs beyond
// most_kept are only counted.
int64_t Rasterization::find_pairs(const float* means, int64_t limit, int64_t most_kept, const EachChunk& each_chunk) {
  set_levels(canvas_.pyramid ? kMaxLevel : 0);
  chunk_ = bin_size(n_, tiles());
  bins_.resize((n_ + chunk_ - 1) / chunk_);
  std::atomic<int> top{canvas_.texture == nullptr ? 0 : std::max(canvas_.texture->top(), 0)};
  std::atomic<int64_t> total{0};
  each_chunk([&](int first, int last, int k) {
    bins_[k] = Bin(first, last, tiles());
    Placed placed;
    Crossings crossings;
    int highest = 0;
    for (int i = first; i < last; i += Placed::kMost) {
      place(means, factors_.data(), i, std::min(last - i, Placed::kMost), canvas_.pyramid, reach_, placed);
      for (int j = 0; j < placed.count; ++j) {
        footprints_[i + j] = placed.footprint(j);
        levels_[i + j] = static_cast<uint8_t>(placed.level[j]);
        highest = std::max(highest, placed.level[j]);
      }
      for (Cursor at; at.gaussian < placed.count; crossings.count = 0) {
        kernels(isa_).cross(placed, grids_.data(), first_tile_.data(), reach_, at, crossings);
        // An empty strip counts too, because it takes time.
        int64_t found = 0, pairs = 0;
        for (int c = 0; c < crossings.count; ++c) {
          pairs += crossings.blocks[c];
          found += std::max(crossings.blocks[c], 1);
        }
        const int64_t before = total.fetch_add(found, std::memory_order_relaxed);
        if (before + found <= most_kept) bin(crossings, pairs, bins_[k]);
        else if (before + found > limit) return;
      }
    }
    for (int seen = top; seen < highest && !top.compare_exchange_weak(seen, highest);) {
    }
  });
  set_levels(top);
  return total;
}

void Rasterization::bin(const Crossings& c, int64_t pairs, Bin& bin) const {
  const size_t before = bin.places.size();
  bin.pairs.resize(before + pairs);
  bin.places.resize(before + pairs);
  Pair* pair = bin.pairs.data() + before;
  int32_t *place = bin.places.data() + before, *next = bin.next.data();
  const auto add = [&](int32_t gaussian, int32_t within, int32_t tile) {
    pair->gaussian = gaussian;
    std::memcpy(&pair->first_row, &within, sizeof within);
    ++pair;
    *place++ = tile;
    ++next[tile];
  };
  for (int k = 0; k < c.count; ++k) {
    const int32_t gaussian = c.gaussian[k], blocks = c.blocks[k];
    bin.counts[gaussian - bin.first] += blocks;
    if (blocks == 0) continue;
    add(gaussian, c.within[k], c.tile[k]);
    if (blocks == 1) continue;
    const int32_t lanes = c.within[k] >> 16 << 16, across = grids_[levels_[gaussian]].strips();
    for (int block = 1; block < blocks; ++block) {
      const int32_t last_row = std::min(c.last_row[k] - block * kTileHeight, kTileHeight - 1);
      add(gaussian, lanes | last_row << 8, c.tile[k] + block * across);
    }
  }
}

// A counting sort by tile. Bins are in order, so each tile's Gaussians are in order of index.
void Rasterization::sort_pairs() {
  // Bin by bin, so that the loop over neighbouring tiles is vectorised.
  const int count = tiles();
  std::vector<int32_t> next(count);
  parallel_chunks(count, kTilesTogether, [&](int first, int last, int) {
    for (const Bin& bin : bins_)
      for (int tile = first; tile < last; ++tile) next[tile] += bin.next[tile];
  });
  tile_start_.resize(count + 1);
  int64_t total = 0;
  for (int tile = 0; tile < count; ++tile) {
    tile_start_[tile] = total;
    total += std::exchange(next[tile], static_cast<int32_t>(total));
  }
  tile_start_[count] = total;
  parallel_chunks(count, kTilesTogether, [&](int first, int last, int) {
    for (Bin& bin : bins_)
      for (int tile = first; tile < last; ++tile) {
        const int32_t here = bin.next[tile];
        bin.next[tile] = next[tile];
        next[tile] += here;
      }
  });
  pairs_.reset(new Pair[total]);  // uninitialised: every element is written below
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

}  // namespace sg
