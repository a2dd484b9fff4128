#include "raster/rasterization.h"

#include <algorithm>
#include <atomic>
#include <cmath>
#include <cstring>
#include <memory>
#include <numeric>
#include <stdexcept>

#include "core/isa.h"
#include "core/thread_pool.h"
#include "raster/kernels.h"

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

int checked_side(int side) {
  require(side > 0, "the image must have pixels");
  require(side <= kMaxGridSide, "the image is too large");
  return side;
}

int checked_isa(int isa) {
  const int best = best_isa();
  require(isa <= best, "this processor lacks the instruction set");
  return isa < 0 ? best : isa;
}

float checked_cutoff(float cutoff) {
  require(cutoff > 0 && cutoff <= kMaxCutoff, "the cutoff is out of range");
  return cutoff;
}

// At least the number of tiles that the box around an ellipse touches; NaN where it overflows.
float box_tiles(const float* l, float reach) {
  const float width = 2.0f * reach * l[0], height = 2.0f * reach * std::sqrt(l[1] * l[1] + l[2] * l[2]);
  return (width / kTileWidth + 2.1f) * (height / kTileHeight + 2.1f);
}

}  // namespace

Rasterization::Rasterization(const float* means, const float* factors, int n, int width, int height, float cutoff, int isa,
                             int64_t max_pairs)
    : n_(n), width_(checked_side(width)), height_(checked_side(height)), strips_((width + kTileWidth - 1) / kTileWidth),
      blocks_((height + kTileHeight - 1) / kTileHeight), isa_(checked_isa(isa)),
      chunk_(bin_size(n, strips_ * blocks_)), reach_(std::sqrt(2.0f * checked_cutoff(cutoff))), floor_(exp_minus(cutoff)),
      footprints_(n), factors_(factors, factors + 3 * static_cast<int64_t>(n)) {
  const int tiles = strips_ * blocks_;
  bins_.resize((n + chunk_ - 1) / chunk_);
  std::atomic<int64_t> total{0};
  parallel_chunks(n, chunk_, [&](int first, int last, int k) {
    int64_t sum = 0;
    for (int i = first; i < last; ++i) {
      const float* factor = factors + 3 * static_cast<int64_t>(i);
      footprints_[i] = Footprint(means + 2 * static_cast<int64_t>(i), factor);
      if (footprints_[i].segment != 0)
        sum += static_cast<int64_t>(std::min(static_cast<float>(tiles), box_tiles(factor, reach_)));
    }
    bins_[k].at_most = sum;
    total.fetch_add(sum, std::memory_order_relaxed);
  });
  max_pairs = std::min(max_pairs, kMaxPairs);
  if (total > max_pairs && pairs_up_to(max_pairs) > max_pairs)
    throw std::overflow_error("too many pairs of Gaussian and tile");
  parallel_chunks(n, chunk_, [&](int first, int last, int k) {
    Bin& bin = bins_[k];
    bin.next.assign(tiles, 0);
    bin.ends.reserve(last - first);
    bin.pairs.reserve(std::min(bin.at_most, kMaxReserve));
    bin.places.reserve(std::min(bin.at_most, kMaxReserve));
    for (int i = first; i < last; ++i) this->bin(i, bin);
  });
  sort_pairs();
}

// A counting sort by tile. Bins come in order, so that each tile's Gaussians come in order of index.
void Rasterization::sort_pairs() {
  const int tiles = strips_ * blocks_;
  tile_start_.resize(tiles + 1);
  int64_t total = 0;
  for (int tile = 0; tile < tiles; ++tile) {
    tile_start_[tile] = total;
    for (Bin& bin : bins_) {
      const int32_t count = bin.next[tile];
      bin.next[tile] = static_cast<int32_t>(total);
      total += count;
    }
  }
  tile_start_[tiles] = total;
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
  return sg::spans(footprints_[gaussian], factor, reach_, width_, height_, visit);
}

int64_t Rasterization::pairs_up_to(int64_t limit) const {
  std::atomic<int64_t> total{0};
  parallel_chunks(n_, kChunk, [&](int first, int last, int) {
    for (int i = first; i < last && total.load(std::memory_order_relaxed) <= limit; ++i) {
      int64_t pairs = 0;
      const int strips =
          spans(i, [&](int, int row0, int row1) { pairs += row1 / kTileHeight - row0 / kTileHeight + 1; });
      total.fetch_add(std::max<int64_t>(pairs, strips), std::memory_order_relaxed);
    }
  });
  return total;
}

void Rasterization::bin(int gaussian, Bin& bin) const {
  spans(gaussian, [&](int strip, int row0, int row1) {
    for (int base = row0 / kTileHeight * kTileHeight; base <= row1; base += kTileHeight) {
      const int tile = base / kTileHeight * strips_ + strip;
      bin.pairs.push_back({gaussian, static_cast<int16_t>(std::max(row0 - base, 0)),
                           static_cast<int16_t>(std::min(row1 - base, kTileHeight - 1))});
      bin.places.push_back(tile);
      ++bin.next[tile];
    }
  });
  bin.ends.push_back(static_cast<int32_t>(bin.places.size()));
}

Rasterization::Area Rasterization::area(int tile) const {
  const int x = (tile % strips_) * kTileWidth, y = (tile / strips_) * kTileHeight;
  return {x, y, std::min(kTileWidth, width_ - x), std::min(kTileHeight, height_ - y)};
}

void Rasterization::render(const float* colors, float* image) const {
  const int64_t plane = static_cast<int64_t>(width_) * height_;
  parallel_for(strips_ * blocks_, [&](int tile) {
    alignas(64) float acc[kTileFloats] = {};
    kernels(isa_).forward(*this, tile, colors, acc);
    const auto [x0, y0, columns, rows] = area(tile);
    for (int row = 0; row < rows; ++row)
      for (int k = 0; k < 3; ++k)
        std::memcpy(image + k * plane + static_cast<int64_t>(y0 + row) * width_ + x0, acc + (row * 3 + k) * kTileWidth,
                    columns * sizeof(float));
  });
}

void Rasterization::render_bytes(const float* colors, const float* background, uint8_t* image) const {
  parallel_for(strips_ * blocks_, [&](int tile) {
    alignas(64) float acc[kTileFloats];
    for (int i = 0; i < 3 * kTileWidth; ++i) acc[i] = background[i / kTileWidth];
    for (int row = 1; row < kTileHeight; ++row) std::copy_n(acc, 3 * kTileWidth, acc + row * 3 * kTileWidth);
    kernels(isa_).forward(*this, tile, colors, acc);
    const auto [x0, y0, columns, rows] = area(tile);
    kernels(isa_).bytes(acc, columns, rows, image + 3 * (static_cast<int64_t>(y0) * width_ + x0), 3 * int64_t{width_});
  });
}

void Rasterization::backward(const float* colors, const float* image_grad, const Gradients& out) const {
  const int64_t plane = static_cast<int64_t>(width_) * height_;
  const std::unique_ptr<float[]> pair_gradients(new float[tile_start_.back() * kPairGradients]);  // all written below
  parallel_for(strips_ * blocks_, [&](int tile) {
    alignas(64) float gradient[kTileFloats] = {};
    const auto [x0, y0, columns, rows] = area(tile);
    for (int row = 0; row < rows; ++row)
      for (int k = 0; k < 3; ++k)
        std::memcpy(gradient + (row * 3 + k) * kTileWidth,
                    image_grad + k * plane + static_cast<int64_t>(y0 + row) * width_ + x0, columns * sizeof(float));
    fit_kernels(isa_).backward(*this, tile, colors, gradient, pair_gradients.get() + tile_start_[tile] * kPairGradients);
  });
  sum_pairs(pair_gradients.get(), out);
}

double Rasterization::squared_error(const float* colors, const float* target, const Gradients& out) const {
  const int64_t plane = static_cast<int64_t>(width_) * height_;
  const float scale = 2.0f / static_cast<float>(3 * plane);
  const std::unique_ptr<float[]> pair_gradients(new float[tile_start_.back() * kPairGradients]);  // all written below
  std::vector<double> errors(static_cast<size_t>(strips_) * blocks_);
  // The processor does not foresee the rows of a large picture, because they lie too far apart. So each kernel asks for
  // those of the next tile.
  constexpr int ahead = 2 * kTileWidth - 1;
  parallel_for(strips_ * blocks_, [&](int tile) {
    const auto [x0, y0, columns, rows] = area(tile);
    const TileTarget wanted{target + static_cast<int64_t>(y0) * width_ + x0, plane, width_, ahead, columns, rows, scale};
    const std::unique_ptr<float[]> first(new float[first_value_count(*this, tile)]);  // all written by the kernel
    errors[tile] = fit_kernels(isa_).squared_error(*this, tile, colors, wanted, first.get(),
                                                   pair_gradients.get() + tile_start_[tile] * kPairGradients);
  });
  sum_pairs(pair_gradients.get(), out);
  return std::accumulate(errors.begin(), errors.end(), 0.0) / static_cast<double>(3 * plane);
}

// In the order of each Gaussian's pairs, so that the sums are the same for every number of threads.
void Rasterization::sum_pairs(const float* pair_gradients, const Gradients& out) const {
  parallel_chunks(n_, chunk_, [&](int first, int last, int k) {
    const int32_t* place = bins_[k].places.data();
    for (int64_t i = first; i < last; ++i) {
      float sum[kPairGradients] = {};
      for (const int32_t* end = bins_[k].places.data() + bins_[k].ends[i - first]; place < end; ++place) {
        const float* gradient = pair_gradients + static_cast<int64_t>(*place) * kPairGradients;
        for (int j = 0; j < kPairGradients; ++j) sum[j] += gradient[j];
      }
      std::copy_n(sum, 2, out.means + 2 * i);
      std::copy_n(sum + 2, 3, out.factors + 3 * i);
      std::copy_n(sum + 5, 3, out.colors + 3 * i);
    }
  });
}

}  // namespace sg
