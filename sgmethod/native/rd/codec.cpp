// The stream of profile rd (docs/format.md, versions 3 and 4).
//
// Classes of size come from the largest down. Each class divides the picture into cells about as wide as its Gaussians.
// Within a class, Gaussians come in the order of their cells' Morton codes, and each cell is coded as the distance along
// that curve from the one before: no bits are spent on the order, which a set does not have. After the cell come the
// colour, u within its class, v, r, and the position within the cell.
#include "rd/codec.h"

#include <algorithm>
#include <atomic>
#include <stdexcept>

#include "rd/models.h"
#include "core/thread_pool.h"

namespace sg {
namespace {

constexpr int kClassBits = 6;
constexpr int kQuantiseChunk = 256;  // Gaussians of one task
std::atomic<int64_t> clipped{0};

// The number of low bits of a distance that are sent without a model. `count` Gaussians in the cells of a class are
// cells / count apart on average. A model pays only for the bits from a quarter of that upwards.
int raw_distance_bits(const RdParameters& p, int size_class, uint32_t count) {
  const int bits = cell_bits(size_class);
  const uint64_t cells = static_cast<uint64_t>(cells_along(p.width, bits)) * cells_along(p.height, bits);
  int result = 0;
  for (uint64_t mean = cells / std::max(count, 1u); mean >= 8; mean /= 2) ++result;
  return result;
}

// The Morton code of the next Gaussian of a class. Throws std::runtime_error if it has more than 32 bits.
template <typename Coder>
uint32_t code_cell(Coder& coder, Model& model, int raw_bits, uint32_t previous, uint32_t cell = 0) {
  const uint32_t distance = cell - previous;
  const uint64_t high = code_number(coder, model, distance >> raw_bits);
  const uint64_t next = previous + (high << raw_bits) + code_bits(coder, distance & ((1u << raw_bits) - 1), raw_bits);
  if (next > 0xFFFFFFFFull) throw std::runtime_error("a position is out of range");
  return static_cast<uint32_t>(next);
}

// The most Gaussians that a payload may hold. A decoder's memory and time thus follow the bytes it is given. Fitted
// Gaussians are far from the limit: they take 20 bits and more.
uint64_t most_in(const RdParameters& p, size_t bytes) {
  const uint64_t pixels = static_cast<uint64_t>(p.width) * static_cast<uint64_t>(p.height);
  return std::min({pixels, kMaxGaussians, uint64_t{8} * bytes + 64});
}

// Calls visit(i, integers) for each Gaussian, in parallel; without integers where nothing is left of it.
template <typename Visit>
void for_each_quantised(const RdParameters& p, const float* means, const float* factors, const float* colors, int n,
                        const Visit& visit) {
  parallel_each(n, kQuantiseChunk, [&](int64_t i) {
    Symbols s{};
    int moved = 0;
    visit(i, quantise(p, means + 2 * i, factors + 3 * i, colors + 3 * i, s, moved) ? &s : nullptr);
    if (moved != 0) clipped.fetch_add(moved, std::memory_order_relaxed);
  });
}

// Decodes `size` bytes; with prefix = true, up to the first Gaussian that needs more.
class Decoding {
 public:
  Decoding(GaussianArrays& out, const RdParameters& p, const uint8_t* data, size_t size, bool prefix, uint64_t limit)
      : out_(out), p_(p), size_(size), prefix_(prefix), most_(most_in(p, size)), limit_(limit), coder_(data) {}

  // False where a prefix ended. Throws std::runtime_error on what no encoder writes.
  bool run() {
    const bool begun = coder_.state() >= kStateLow;
    const int first = kMaxClass - static_cast<int>(coder_.raw(0, kClassBits));
    const int last = first - static_cast<int>(coder_.raw(0, kClassBits));
    if (prefix_ && overrun()) return false;
    if (!begun || last < kMinClass) throw std::runtime_error("no encoder begins like this");
    for (int c = first; c >= last; --c)
      if (!size_class(c)) return false;
    if (!prefix_ && coder_.state() != kStateLow) throw std::runtime_error("the last Gaussian does not end as it should");
    return true;
  }

  size_t read() const { return coder_.read(); }
  bool overrun() const { return coder_.read() > size_; }

 private:
  bool size_class(int c) {
    const uint32_t count = code_number(coder_, models_.count);
    if (!whole()) return false;
    const size_t done = out_.means.size() / 2;
    if (!prefix_ && count > most_ - done) throw std::runtime_error("more Gaussians than the data can hold");
    const size_t room = std::min<uint64_t>(count, most_ - done);
    if (done + room > limit_) throw std::overflow_error("more Gaussians than the limit");
    resize(done + room);
    Symbols s{};
    s.size_class = c;
    const int raw_bits = raw_distance_bits(p_, c, count);
    for (size_t i = done; i < done + room; ++i) {
      try {
        s.cell = code_cell(coder_, models_.distance, raw_bits, s.cell);
        if (!in_grid(p_, cell_bits(c), s.cell)) throw std::runtime_error("a position is out of range");
        const Geometry geometry = models_.gaussian(coder_, p_, s);
        if (whole()) {
          dequantise(p_, s, geometry, &out_.means[2 * i], &out_.factors[3 * i], &out_.colors[3 * i]);
          continue;
        }
      } catch (const std::runtime_error&) {
        if (!prefix_ || !overrun()) throw;  // what stands past the end of a prefix means nothing
      }
      resize(i);
      return false;
    }
    return room == count;
  }

  // False if a prefix has ended.
  bool whole() const {
    if (!overrun()) return true;
    if (!prefix_) throw std::runtime_error("the data end too early");
    return false;
  }

  void resize(size_t n) {
    out_.means.resize(2 * n);
    out_.factors.resize(3 * n);
    out_.colors.resize(3 * n);
  }

  GaussianArrays& out_;
  const RdParameters& p_;
  const size_t size_;
  const bool prefix_;
  const uint64_t most_, limit_;
  RansDecoder coder_;
  Models models_;
};

}  // namespace

RdParameters::RdParameters(int width, int height, double quantum, bool grey, bool upright, int version)
    : width(width), height(height), quantum(quantum), grey(grey), upright(upright), version(version) {
  if (version != 3 && version != 4) throw std::invalid_argument("no such version of profile rd");
  if (!(width > 0 && height > 0 && quantum > 0)) throw std::invalid_argument("parameters must be positive");
  if (width > kMaxSide || height > kMaxSide) throw std::invalid_argument("a side is more than 65535 pixels");
}

int64_t clipped_values() { return clipped.load(std::memory_order_relaxed); }

std::vector<Symbols> quantised(const RdParameters& p, const float* means, const float* factors, const float* colors,
                               int n) {
  std::vector<Symbols> all(n);
  for_each_quantised(p, means, factors, colors, n, [&](int64_t i, const Symbols* s) {
    if (s) all[i] = *s;
  });
  erase_empty(all);
  return all;
}

void rd_quantise(const RdParameters& p, const float* means, const float* factors, const float* colors, int n,
                 float* out_means, float* out_factors, float* out_colors) {
  for_each_quantised(p, means, factors, colors, n, [&](int64_t i, const Symbols* s) {
    if (s) {
      dequantise(p, *s, Geometry(*s, Steps(p, *s)), out_means + 2 * i, out_factors + 3 * i, out_colors + 3 * i);
    } else {
      std::copy_n(means + 2 * i, 2, out_means + 2 * i);
      std::copy_n(factors + 3 * i, 3, out_factors + 3 * i);
      std::fill_n(out_colors + 3 * i, 3, 0.0f);
    }
  });
}

std::vector<uint8_t> encode_symbols(const RdParameters& p, std::vector<Symbols>& all, Models& models) {
  if (all.empty()) return {};
  if (all.size() > most_in(p, SIZE_MAX / 16)) throw std::invalid_argument("more Gaussians than pixels, or than 2^24");
  std::stable_sort(all.begin(), all.end(), [](const Symbols& a, const Symbols& b) {
    return a.size_class != b.size_class ? a.size_class > b.size_class : a.cell < b.cell;
  });
  RansEncoder coder;
  const int first = all.front().size_class, last = all.back().size_class;
  coder.raw(static_cast<uint32_t>(kMaxClass - first), kClassBits);
  coder.raw(static_cast<uint32_t>(first - last), kClassBits);
  size_t at = 0;
  for (int c = first; c >= last; --c) {
    size_t end = at;
    while (end < all.size() && all[end].size_class == c) ++end;
    const auto count = static_cast<uint32_t>(end - at);
    code_number(coder, models.count, count);
    const int raw_bits = raw_distance_bits(p, c, count);
    for (uint32_t previous = 0; at < end; ++at) {
      previous = code_cell(coder, models.distance, raw_bits, previous, all[at].cell);
      models.gaussian(coder, p, all[at]);
    }
  }
  std::vector<uint8_t> bytes = coder.finish();
  // Thousands of equal Gaussians take less than a bit each, and may be more than the payload may hold. Zeros behind the
  // last of them mean nothing.
  while (all.size() > most_in(p, bytes.size())) bytes.push_back(0);
  return bytes;
}

std::vector<uint8_t> rd_encode(const RdParameters& p, const float* means, const float* factors, const float* colors,
                               int n) {
  std::vector<Symbols> all = quantised(p, means, factors, colors, n);
  Models models;
  return encode_symbols(p, all, models);
}

GaussianArrays rd_decode(const RdParameters& p, const uint8_t* data, size_t size, bool prefix, uint64_t max_gaussians) {
  GaussianArrays out;
  if (size == 0) return out;
  std::vector<uint8_t> padded(size + RansDecoder::kSlack);
  std::copy_n(data, size, padded.begin());
  Decoding decoding(out, p, padded.data(), size, prefix, max_gaussians);
  const auto behind = [&] {
    return std::any_of(data + std::min(decoding.read(), size), data + size, [](uint8_t byte) { return byte != 0; });
  };
  if (decoding.run() && !prefix && behind())
    throw std::runtime_error("there are bytes behind the last Gaussian");
  return out;
}

}  // namespace sg
