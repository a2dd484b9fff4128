#include "rasterization.h"

#include <algorithm>
#include <atomic>
#include <cmath>
#include <cstring>
#include <memory>
#include <stdexcept>

#include "kernels.h"
#include "thread_pool.h"

namespace sg {
namespace {

constexpr int kTileFloats = 3 * kTileWidth * kTileHeight;
constexpr int kChunk = 256;       // Gaussians per binning task
constexpr int kMaxSegment = 16;   // rows; the recurrence's relative error stays below 16^2 / 2 * 6e-8
constexpr float kMargin = 0.01f;  // pixels by which a footprint is widened: far more than its rounding error
constexpr float kReach = 3.31662479f;  // sqrt(2 kCutoff): the ellipse in units of its own axes
constexpr double kMaxDecay = 80.0;  // exp(-80): a neighbouring row is far outside the ellipse by then

// A lane with sigma <= kCutoff somewhere in a segment of `rows` has |z2| < sqrt(2 kCutoff) + rows / l3 at its
// first row; sigma < 80 there asks for rows / l3 <= 9.
int segment_rows(float l3) { return std::clamp(static_cast<int>(9.0f * l3), 1, kMaxSegment); }

// exp(-inv_l3^2) rounded from double. It is multiplied up to 120 times, so single precision would show; the C
// library's exp may differ from machine to machine, which pixels must not. exp(-x) = exp(-x / 1024)^1024.
float decay(float inv_l3) {
  const double x = std::min(static_cast<double>(inv_l3) * inv_l3, kMaxDecay) / 1024.0;
  double value = 1.0;
  for (int k = 9; k > 0; --k) value = 1.0 - value * x / k;
  for (int k = 0; k < 10; ++k) value *= value;
  return static_cast<float>(value);
}

bool drawable(const float* mean, const float* factor) {
  return std::isfinite(mean[0]) && std::isfinite(mean[1]) && std::isfinite(factor[1]) && factor[0] > 0.0f &&
         factor[2] > 0.0f && std::isfinite(factor[0]) && std::isfinite(factor[2]) && std::isfinite(1.0f / factor[0]) &&
         std::isfinite(1.0f / (factor[2] * factor[2])) && std::isfinite(factor[1] / factor[0]);
}

// At least the number of tiles that the box around an ellipse touches; not a number where it overflows.
float box_tiles(const float* l) {
  const float width = 2.0f * kReach * l[0], height = 2.0f * kReach * std::sqrt(l[1] * l[1] + l[2] * l[2]);
  return (width / kTileWidth + 2.1f) * (height / kTileHeight + 2.1f);
}

// Splits [0, count) into tasks of `chunk`.
template <typename Body>
void parallel_chunks(int count, int chunk, const Body& body) {
  parallel_for((count + chunk - 1) / chunk,
               [&](int i) { body(i * chunk, std::min(count, (i + 1) * chunk), i); });
}

// A value that is not a number, which geometry beyond single precision can come to, gives low.
int clamp_to_int(float v, int low, int high) {
  if (!(v > static_cast<float>(low))) return low;
  return v < static_cast<float>(high) ? static_cast<int>(v) : high;
}

}  // namespace

Rasterization::Rasterization(const float* means, const float* factors, int n, int width, int height, int isa,
                             int64_t max_pairs)
    : n_(n), width_(width), height_(height), strips_((width + kTileWidth - 1) / kTileWidth),
      blocks_((height + kTileHeight - 1) / kTileHeight), isa_(isa), footprints_(n), factors_(factors, factors + 3 * static_cast<int64_t>(n)) {
  const int chunks = (n + kChunk - 1) / kChunk;
  const int tiles = strips_ * blocks_;
  std::atomic<int64_t> at_most{0};
  parallel_chunks(n, kChunk, [&](int first, int last, int) {
    int64_t sum = 0;
    for (int i = first; i < last; ++i) {
      const float* factor = factors + 3 * static_cast<int64_t>(i);
      footprints_[i] = prepare(means + 2 * static_cast<int64_t>(i), factor);
      if (footprints_[i].segment != 0)
        sum += static_cast<int64_t>(std::min(static_cast<float>(tiles), box_tiles(factor)));
    }
    at_most.fetch_add(sum, std::memory_order_relaxed);
  });
  if (at_most > max_pairs && pairs_up_to(max_pairs) > max_pairs)
    throw std::overflow_error("too many pairs of Gaussian and tile");
  std::vector<Bin> bins(chunks);
  parallel_chunks(n, kChunk, [&](int first, int last, int chunk) {
    for (int i = first; i < last; ++i) bin(i, bins[chunk]);
  });

  // Counting sort by tile; chunks in order, so that each tile's Gaussians come in order of index.
  tile_start_.assign(tiles + 1, 0);
  for (const Bin& bin : bins)
    for (int32_t tile : bin.tiles) ++tile_start_[tile + 1];
  for (int t = 0; t < tiles; ++t) tile_start_[t + 1] += tile_start_[t];
  pairs_.reset(new Pair[tile_start_[tiles]]);  // left unset: every place is written below
  std::vector<int64_t> next(tile_start_.begin(), tile_start_.end() - 1);
  for (const Bin& bin : bins)
    for (size_t k = 0; k < bin.pairs.size(); ++k) pairs_[next[bin.tiles[k]]++] = bin.pairs[k];
}

Footprint Rasterization::prepare(const float* mean, const float* factor) const {
  Footprint f{};
  if (!drawable(mean, factor)) return f;
  f.x = mean[0];
  f.y = mean[1];
  f.inv_l1 = 1.0f / factor[0];
  f.inv_l3 = 1.0f / factor[2];
  f.shear = factor[1] / factor[0];
  f.decay = decay(f.inv_l3);
  f.segment = segment_rows(factor[2]);
  return f;
}

// The rows an ellipse covers within one strip: the edge above dx is
// shear dx + l3 sqrt(kReach^2 - (dx / l1)^2), concave, with its summit at dx = kReach l1 l2 / sqrt(l2^2 + l3^2).
// Calls visit(strip, first row, last row) for each strip in which there are any; returns the strips looked at.
template <typename Visit>
int Rasterization::spans(int gaussian, const Visit& visit) const {
  const Footprint& f = footprints_[gaussian];
  if (f.segment == 0) return 0;
  const float* l = factors_.data() + 3 * static_cast<int64_t>(gaussian);
  const float reach = kReach * l[0];
  const float height = std::sqrt(l[1] * l[1] + l[2] * l[2]);
  const float summit = reach * l[1] / height;
  const float beyond = kReach * 1.001f * height + 1.0f;  // far more than any rounding error
  if (f.y + beyond < 0.0f || f.y - beyond > static_cast<float>(height_)) return 0;
  const auto edge = [&](float dx) {
    const float z = dx * f.inv_l1;
    return l[2] * std::sqrt(std::max(kReach * kReach - z * z, 0.0f));
  };
  const int s0 = clamp_to_int(std::floor((f.x - reach - kMargin - 0.5f) / kTileWidth), 0, strips_);
  const int s1 = clamp_to_int(std::floor((f.x + reach + kMargin) / kTileWidth), -1, strips_ - 1);
  for (int strip = s0; strip <= s1; ++strip) {
    const float left = std::clamp(static_cast<float>(strip * kTileWidth) - f.x, -reach, reach);
    const float right = std::clamp(static_cast<float>((strip + 1) * kTileWidth) - f.x, -reach, reach);
    const float top_dx = std::clamp(-summit, left, right), bottom_dx = std::clamp(summit, left, right);
    const float top = f.y + f.shear * top_dx - edge(top_dx) - kMargin;
    const float bottom = f.y + f.shear * bottom_dx + edge(bottom_dx) + kMargin;
    const int row0 = clamp_to_int(std::ceil(top - 0.5f), 0, height_);
    const int row1 = clamp_to_int(std::floor(bottom - 0.5f), -1, height_ - 1);
    if (row0 <= row1) visit(strip, row0, row1);
  }
  return std::max(s1 - s0 + 1, 0);
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
      bin.pairs.push_back({gaussian, static_cast<int16_t>(std::max(row0 - base, 0)),
                           static_cast<int16_t>(std::min(row1 - base, kTileHeight - 1))});
      bin.tiles.push_back(base / kTileHeight * strips_ + strip);
    }
  });
}

void Rasterization::render(const float* colors, float* image) const {
  const int64_t plane = static_cast<int64_t>(width_) * height_;
  parallel_for(strips_ * blocks_, [&](int tile) {
    alignas(64) float acc[kTileFloats] = {};
    kernels(isa_).forward(*this, tile, colors, acc);
    const int x0 = (tile % strips_) * kTileWidth, y0 = (tile / strips_) * kTileHeight;
    const int columns = std::min(kTileWidth, width_ - x0), rows = std::min(kTileHeight, height_ - y0);
    for (int row = 0; row < rows; ++row)
      for (int k = 0; k < 3; ++k)
        std::memcpy(image + k * plane + static_cast<int64_t>(y0 + row) * width_ + x0, acc + (row * 3 + k) * kTileWidth,
                    columns * sizeof(float));
  });
}

void Rasterization::render_bytes(const float* colors, const float* background, uint8_t* image) const {
  parallel_for(strips_ * blocks_, [&](int tile) {
    alignas(64) float acc[kTileFloats];
    for (int i = 0; i < kTileFloats; ++i) acc[i] = background[i / kTileWidth % 3];
    kernels(isa_).forward(*this, tile, colors, acc);
    const int x0 = (tile % strips_) * kTileWidth, y0 = (tile / strips_) * kTileHeight;
    const int columns = std::min(kTileWidth, width_ - x0), rows = std::min(kTileHeight, height_ - y0);
    for (int row = 0; row < rows; ++row) {
      // Rounding first, plane by plane, is a loop the compiler turns into vectors; interleaving is not.
      int32_t levels[3 * kTileWidth];
      const float* in = acc + row * 3 * kTileWidth;
      for (int i = 0; i < 3 * kTileWidth; ++i)
        levels[i] = static_cast<int32_t>(std::min(std::max(in[i], 0.0f), 1.0f) * 255.0f + 0.5f);
      uint8_t* out = image + 3 * (static_cast<int64_t>(y0 + row) * width_ + x0);
      for (int column = 0; column < columns; ++column, out += 3)
        for (int k = 0; k < 3; ++k) out[k] = static_cast<uint8_t>(levels[k * kTileWidth + column]);
    }
  });
}

void Rasterization::backward(const float* colors, const float* image_grad, const Gradients& out) const {
  const int64_t plane = static_cast<int64_t>(width_) * height_;
  const std::unique_ptr<float[]> pair_gradients(new float[tile_start_.back() * kPairGradients]);  // all written below
  parallel_for(strips_ * blocks_, [&](int tile) {
    alignas(64) float gradient[kTileFloats] = {};
    const int x0 = (tile % strips_) * kTileWidth, y0 = (tile / strips_) * kTileHeight;
    const int columns = std::min(kTileWidth, width_ - x0), rows = std::min(kTileHeight, height_ - y0);
    for (int row = 0; row < rows; ++row)
      for (int k = 0; k < 3; ++k)
        std::memcpy(gradient + (row * 3 + k) * kTileWidth, image_grad + k * plane + static_cast<int64_t>(y0 + row) * width_ + x0,
                    columns * sizeof(float));
    kernels(isa_).backward(*this, tile, colors, gradient, pair_gradients.get() + tile_start_[tile] * kPairGradients);
  });
  // One thread, in order of tile: a few per cent of the time, and the sums are the same for every number of threads.
  std::fill_n(out.means, 2 * static_cast<int64_t>(n_), 0.0f);
  std::fill_n(out.factors, 3 * static_cast<int64_t>(n_), 0.0f);
  std::fill_n(out.colors, 3 * static_cast<int64_t>(n_), 0.0f);
  const float* gradient = pair_gradients.get();
  for (int64_t p = 0; p < tile_start_.back(); ++p) {
    const int64_t i = pairs_[p].gaussian;
    for (int k = 0; k < 2; ++k) out.means[2 * i + k] += gradient[k];
    for (int k = 0; k < 3; ++k) out.factors[3 * i + k] += gradient[2 + k];
    for (int k = 0; k < 3; ++k) out.colors[3 * i + k] += gradient[5 + k];
    gradient += kPairGradients;
  }
}

}  // namespace sg
