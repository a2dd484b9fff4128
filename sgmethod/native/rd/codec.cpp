// The stream of profile rd (docs/format.md, version 2).
//
// Classes of size come from the largest down. Each class divides the picture into cells about as wide as its Gaussians.
// Within a class, Gaussians come in the order of their cells' Morton codes, and each cell is coded as the distance
// along that curve from the one before: no bits are spent on the order, which a set does not have. Then come the
// colour, u within its class, v, r, and the position within the cell.
//
// The integers of many Gaussians are decoded first. What follows from each by itself comes after, in vectors and on
// several threads.
#include "rd/codec.h"

#include <algorithm>
#include <memory>

#include "core/errors.h"
#include "core/isa.h"
#include "core/thread_pool.h"
#include "rd/models.h"

namespace sg {
namespace {

constexpr int kClassBits = 6, kMaxRawDistanceBits = 24;
constexpr int kChunk = 256;  // Gaussians of one task
constexpr int kBatch = 2048;  // Gaussians whose values are made together

// The number of low bits of a distance that are sent without a model. `count` Gaussians in the cells of a class are
// cells / count apart on average. A model pays only for the bits from a quarter of that upwards.
int raw_distance_bits(const RdParameters& p, int size_class, uint32_t count) {
  const int bits = cell_bits(size_class);
  const uint64_t cells = static_cast<uint64_t>(cells_along(p.width, bits)) * cells_along(p.height, bits);
  int result = 0;
  for (uint64_t mean = cells / std::max(count, 1u); mean >= 8; mean /= 2) ++result;
  return std::min(result, kMaxRawDistanceBits);
}

SizeClass class_of(const RdParameters& p, int number, uint32_t count) {
  const int bits = cell_bits(number);
  return {number, raw_distance_bits(p, number, count), spread_bits(cells_along(p.width, bits) - 1),
          spread_bits(cells_along(p.height, bits) - 1) << 1};
}

// The most Gaussians that a payload may hold. A decoder's memory and time thus follow the bytes it is given. Fitted
// Gaussians are far from the limit: they take 20 bits and more.
uint64_t most_in(const RdParameters& p, size_t bytes) {
  const uint64_t pixels = static_cast<uint64_t>(p.width) * static_cast<uint64_t>(p.height);
  return std::min({pixels, kMaxGaussians, uint64_t{8} * bytes + 64});
}

template <typename Coder>
uint32_t code_class_number(Coder& coder, uint32_t value = 0) {
  coder.fetch(kClassBits);
  return coder.raw(value, kClassBits);
}

void encode_class(Encoder& coder, Models& models, const RdParameters& p, int size_class, Symbols* s, Symbols* end) {
  if (s == end) return;
  const SizeClass c = class_of(p, size_class, static_cast<uint32_t>(end - s));
  ColorSize size;
  models.pair<true, false>(coder, p, c, 0, size, *s, *s);
  for (; s + 1 < end; ++s) models.pair<true, true>(coder, p, c, s->cell, size, s[1], s[0]);
  models.pair<false, true>(coder, p, c, s->cell, size, *s, *s);
}

}  // namespace

// Gaussians whose integers are decoded, and behind them perhaps one that has only its cell and colour.
struct Batch {
  explicit Batch(size_t room, size_t step)
      : step(std::min(room, step)), stop(this->step), symbols(new Symbols[room + 1]), parts(new Parts[room]) {}
  const size_t step;
  size_t n = 0, stop;  // Gaussians decoded; where to stop and hand them on, at most `room`
  std::unique_ptr<Symbols[]> symbols;
  std::unique_ptr<Parts[]> parts;

  // Writes those of [first, last), which have come.
  void values(const RdParameters& p, int first, int last, const MutableGaussians& out) const {
    dequantise(p, &symbols[first], &parts[first], last - first, out);
  }
};

namespace {

// The state of a decoder. With prefix = true, it goes up to the first Gaussian that needs more.
template <size_t kStates>
struct Decoding {
  using Coder = Decoder<kStates>;

  const RdParameters& p;
  const size_t size;
  const bool prefix;
  Batch& batch;
  const std::function<void()>& reached;  // the batch's stop: it sets another
  Coder coder;
  Models models{};

  // All that follow take the decoder in its current state, since a loop has a copy of its own.
  bool overrun(const Coder& now) const { return now.read() > size; }
  // False if a prefix has ended.
  bool whole(const Coder& now) const {
    if (!overrun(now)) return true;
    if (!prefix) refuse<std::runtime_error>("the data end too early");
    return false;
  }
  // Runs a loop that decodes by `now`. What is refused past the end of a prefix means nothing.
  template <typename Loop>
  SG_INLINE void attempt(const Coder& now, const Loop& loop) const {
    try {
      loop();
    } catch (const std::runtime_error&) {
      if (!prefix || !overrun(now)) throw;
    }
  }
};

// Adds `wanted` Gaussians of a class to the batch, or less where a prefix ends: the first of the class if `begin`, not
// its last if `more`. of_next: of the Gaussian behind them.
template <size_t kStates>
SG_INLINE void decode_batch_body(Decoding<kStates>& d, ColorSize& of_next, const SizeClass& c, int wanted, bool begin,
                                 bool more) {
  Batch& batch = d.batch;
  auto coder = d.coder;  // copies, to be kept in registers
  ColorSize size = of_next;
  const RdParameters p = d.p;
  const SizeClass by = c;
  Models& models = d.models;
  Symbols* s = &batch.symbols[batch.n];
  Parts* parts = &batch.parts[batch.n];
  int found = 0;
  d.attempt(coder, [&]() SG_INLINE_LAMBDA {
    s->size_class = by.number;
    if (begin) models.pair<true, false>(coder, p, by, 0, size, *s, *s);
    for (const int pairs = more ? wanted : wanted - 1; found < pairs; ++found, ++s) {
      s[1].size_class = by.number;
      parts[found] = models.pair<true, true>(coder, p, by, s->cell, size, s[1], s[0]);
      if (!d.whole(coder)) break;
    }
    if (!more && found == wanted - 1) {
      parts[found] = models.pair<false, true>(coder, p, by, s->cell, size, *s, *s);
      found += d.whole(coder);
    }
  });
  batch.n += found;
  of_next = size;
  d.coder = coder;
}
#if SG_X86
template <auto body, typename... Arguments>
[[gnu::target("avx2,bmi,bmi2,lzcnt")]] auto with_bit_operations(Arguments... arguments) {
  return body(arguments...);
}
#endif

template <size_t kStates>
using DecodeBatch = void (*)(Decoding<kStates>&, ColorSize&, const SizeClass&, int wanted, bool begin, bool more);
template <size_t kStates>
DecodeBatch<kStates> best_decode_batch() {
#if SG_X86
  if (best_isa() >= kAvx2 && has_bit_operations()) return with_bit_operations<decode_batch_body<kStates>>;
#endif
  return for_baseline<decode_batch_body<kStates>>;
}

template <size_t kStates>
size_t read_class(Decoding<kStates>& d, int size_class, uint32_t count, size_t room) {
  static const auto decode_batch = best_decode_batch<kStates>();
  const SizeClass c = class_of(d.p, size_class, count);
  ColorSize of_next;
  size_t found = 0;
  while (found < room) {
    if (d.batch.n == d.batch.stop) d.reached();
    const size_t wanted = std::min(room - found, d.batch.stop - d.batch.n), before = d.batch.n;
    decode_batch(d, of_next, c, static_cast<int>(wanted), found == 0, found + wanted < count);
    found += d.batch.n - before;
    if (d.batch.n - before < wanted) break;
  }
  return found;
}

// Decodes a payload. False where a prefix ended. Throws std::runtime_error on what no encoder writes.
template <size_t kStates>
bool decode_payload(Decoding<kStates>& d, uint64_t limit) {
  const uint64_t most = most_in(d.p, d.size);
  const bool begun = d.coder.begins();
  const int first = kMaxClass - static_cast<int>(code_class_number(d.coder));
  const int last = first - static_cast<int>(code_class_number(d.coder));
  if (d.prefix && d.overrun(d.coder)) return false;
  if (!begun || last < kMinClass) refuse<std::runtime_error>("no encoder begins like this");
  size_t done = 0;
  for (int c = first; c >= last; --c) {
    const uint32_t count = code_whole(d.coder, kColorLane, d.models.count);
    if (!d.whole(d.coder)) return false;
    if (!d.prefix && count > most - done) refuse<std::runtime_error>("more Gaussians than the data can hold");
    const size_t room = std::min<uint64_t>(count, most - done);
    if (done + room > limit) refuse<std::overflow_error>("more Gaussians than the limit");
    const size_t found = read_class(d, c, count, room);
    done += found;
    if (found < count) return false;
  }
  if (!d.prefix && !d.coder.ends()) refuse<std::runtime_error>("the last Gaussian does not end as it should");
  return true;
}

template <size_t kStates>
void decode_into(const RdParameters& p, const uint8_t* data, size_t size, bool prefix, uint64_t limit, Batch& batch,
                 const std::function<void()>& reached) {
  std::vector<uint8_t> padded(size + Decoder<kStates>::kSlack);
  std::copy_n(data, size, padded.begin());
  Decoding<kStates> d{p, size, prefix, batch, reached, Decoder<kStates>(padded.data())};
  const bool ended = decode_payload(d, limit);
  const size_t read = std::min(d.coder.read(), size);
  if (ended && !prefix && std::any_of(data + read, data + size, [](uint8_t byte) { return byte != 0; }))
    refuse<std::runtime_error>("there are bytes behind the last Gaussian");
  reached();
}

auto decode_into(const RdParameters& p) { return p.is_short ? decode_into<1> : decode_into<kLanes>; }

}  // namespace

RdParameters::RdParameters(int width, int height, double quantum, bool grey, bool upright, bool is_short)
    : width(width), height(height), quantum(quantum), grey(grey), upright(upright), is_short(is_short) {
  if (!(width > 0 && height > 0 && quantum > 0)) refuse<std::invalid_argument>("parameters must be positive");
  if (width > kMaxSide || height > kMaxSide) refuse<std::invalid_argument>("a side is more than 65535 pixels");
}

std::vector<uint8_t> encode_symbols(const RdParameters& p, std::vector<Symbols>& all, Models& models) {
  if (all.empty()) return {};
  if (all.size() > most_in(p, SIZE_MAX / 16)) refuse<std::invalid_argument>("more Gaussians than pixels, or than 2^24");
  std::stable_sort(all.begin(), all.end(), [](const Symbols& a, const Symbols& b) {
    return a.size_class != b.size_class ? a.size_class > b.size_class : a.cell < b.cell;
  });
  Encoder coder;
  const int first = all.front().size_class, last = all.back().size_class;
  code_class_number(coder, static_cast<uint32_t>(kMaxClass - first));
  code_class_number(coder, static_cast<uint32_t>(first - last));
  Symbols* at = all.data();
  Symbols* const behind = at + all.size();
  for (int c = first; c >= last; --c) {
    Symbols* end = at;
    while (end < behind && end->size_class == c) ++end;
    code_whole(coder, kColorLane, models.count, static_cast<uint32_t>(end - at));
    encode_class(coder, models, p, c, at, end);
    at = end;
  }
  std::vector<uint8_t> bytes = coder.finish(p.is_short ? 1 : kLanes);
  // Thousands of equal Gaussians take less than a bit each, and may be more than the payload may hold. Zeros behind the
  // last of them mean nothing.
  while (all.size() > most_in(p, bytes.size())) bytes.push_back(0);
  return bytes;
}

std::vector<uint8_t> rd_encode(const RdParameters& p, const ConstGaussians& gaussians, int n) {
  std::vector<Symbols> all = quantised(p, gaussians, n);
  Models models;
  return encode_symbols(p, all, models);
}

GaussianArrays rd_decode(const RdParameters& p, const uint8_t* data, size_t size, bool prefix, uint64_t max_gaussians) {
  GaussianArrays out;
  if (size == 0) return out;
  const size_t expected = std::min<uint64_t>(most_in(p, size), size / 2);  // in 16 bits each
  out.means.reserve(2 * expected);
  out.factors.reserve(3 * expected);
  out.colors.reserve(3 * expected);
  Batch batch(kBatch, kBatch);
  decode_into(p)(p, data, size, prefix, max_gaussians, batch, [&] {
    const size_t done = out.means.size() / 2, all = done + batch.n;
    out.means.resize(2 * all);
    out.factors.resize(3 * all);
    out.colors.resize(3 * all);
    parallel_chunks(static_cast<int>(batch.n), kChunk, [&](int first, int last, int) {
      const size_t at = done + static_cast<size_t>(first);
      batch.values(p, first, last, {&out.means[2 * at], &out.factors[3 * at], &out.colors[3 * at]});
    });
    batch.symbols[0] = batch.symbols[batch.n];
    batch.n = 0;
  });
  return out;
}

Arriving::Arriving(const RdParameters& p, size_t room) : p_(p), room_(room), batch_(new Batch(room, kChunk)) {}
Arriving::~Arriving() = default;

void Arriving::decode(const uint8_t* data, size_t size, bool prefix, const std::function<void(int)>& arrived) {
  if (size == 0) return;
  Batch& batch = *batch_;
  decode_into(p_)(p_, data, size, prefix, room_, batch, [&] {
    arrived(static_cast<int>(batch.n));
    batch.stop = std::min(batch.n + batch.step, room_);
  });
}

void Arriving::values(int first, int last, const MutableGaussians& out) const { batch_->values(p_, first, last, out); }

}  // namespace sg
