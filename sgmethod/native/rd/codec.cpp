// The stream of profile rd (docs/format.md, version 2).
//
// Classes of size come from the largest down. Before each, what is decoded says in which blocks of the picture its
// Gaussians are likely (density_map.h). Within a class, Gaussians come block by block, and each place is coded as the
// distance from the one before, which is short where they are likely: no bits are spent on the order, which a set does
// not have. Then come the colour, u within its class, v, r, and what is left of the place.
#include "rd/codec.h"

#include <algorithm>
#include <memory>

#include "core/errors.h"
#include "core/isa.h"
#include "rd/density_map.h"
#include "rd/models.h"

namespace sg {
namespace {

constexpr int kClassBits = 6;
constexpr int kChunk = 256;  // Gaussians whose values are made together

SizeClass class_of(const RdParameters& p, int number) {
  const int bits = cell_bits(number);
  return {number, cells_along(p.width, bits), cells_along(p.height, bits)};
}

// Whether a class goes into the map: nothing of a short file does, and the last class tells nobody anything.
bool is_mapped(const RdParameters& p, int number, int last) { return number > last && !p.is_short; }

// What a Gaussian adds to the map for each unit of its shape's aspect.
double strength_of(const Symbols& s) { return static_cast<double>(Steps(s).square) * power_of_two(-2 - s.size_class); }

// The most Gaussians that a payload may hold. A decoder's memory and time thus follow the bytes it is given. Each takes
// three bits at least, the lowest of its distance; fitted ones take 20 and more.
uint64_t max_gaussians_in(const RdParameters& p, size_t bytes) {
  const uint64_t pixels = static_cast<uint64_t>(p.width) * static_cast<uint64_t>(p.height);
  return std::min({pixels, kMaxGaussians, uint64_t{3} * bytes + 64});
}

template <typename Coder>
uint32_t code_class_number(Coder& coder, uint32_t value = 0) {
  coder.fetch(kClassBits);
  return coder.raw(value, kClassBits);
}

// Adds an encoded class to the map.
void add_class(DensityMap& map, const RdParameters& p, const Symbols* s, int n) {
  const auto count = static_cast<size_t>(n);
  std::vector<Parts> parts(count);
  std::vector<double> strengths(count);
  std::vector<float> means(2 * count), factors(3 * count), colors(3 * count);
  for (size_t i = 0; i < count; ++i) {
    parts[i] = parts_of(s[i], Steps(s[i]));
    strengths[i] = strength_of(s[i]);
  }
  dequantise(p, s, parts.data(), n, {means.data(), factors.data(), colors.data()});
  map.add(means.data(), factors.data(), strengths.data(), n);
}

SG_INLINE uint32_t block_of(const DensityMap& map, const Symbols& s) { return map.block_of(s.column, s.row); }
// The part of the current block that a Gaussian is in.
SG_INLINE uint32_t part_of(const DensityMap& map, const Symbols& s) {
  const int halvings = map.halvings();
  const Parts parts = parts_of(s, Steps(s));
  const auto place = [&](uint32_t cell, uint32_t part, int bits) {
    return uint64_t{(cell - 2) & ((1u << halvings) - 1)} << bits | part;
  };
  return map.part_of(place(s.column, s.px, parts.x_bits), halvings + parts.x_bits, place(s.row, s.py, parts.y_bits),
                     halvings + parts.y_bits);
}

// Copies Gaussians in the order of their numbers, which are below `numbers`. Equal ones stay in order.
template <typename NumberOf>
void sort_by(const Symbols* from, size_t n, size_t numbers, const NumberOf& number, Symbols* to) {
  std::vector<uint32_t> next(numbers + 1);
  for (size_t i = 0; i < n; ++i) ++next[number(from[i]) + 1];
  for (size_t k = 1; k < numbers; ++k) next[k] += next[k - 1];
  for (size_t i = 0; i < n; ++i) to[next[number(from[i])]++] = from[i];
}

// Encodes a class, whose Gaussians come block by block, and sorts those of a block.
SG_INLINE void encode_class_body(Encoder& coder, Models& models, const RdParameters& p, DensityMap& map, Symbols* first,
                                 Symbols* end) {
  const SizeClass c = class_of(p, first->size_class);
  std::vector<std::pair<uint32_t, Symbols>> here;  // of a block, by part
  Begun begun;
  for (Symbols* s = first; s < end;) {
    const uint32_t block = block_of(map, *s);
    uint64_t gap = map.to_block(block);
    Symbols* behind = s + 1;
    while (behind < end && block_of(map, *behind) == block) ++behind;
    if (behind - s > 1) {
      here.clear();
      for (const Symbols* one = s; one < behind; ++one) here.emplace_back(part_of(map, *one), *one);
      std::stable_sort(here.begin(), here.end(), [](const auto& a, const auto& b) { return a.first < b.first; });
      std::transform(here.begin(), here.end(), s, [](const auto& one) { return one.second; });
    }
    for (; s < behind; ++s) {
      const uint32_t on = part_of(map, *s) - map.part();
      map.advance(on);
      map.count();
      if ((gap + on) >> kLowBits > UINT32_MAX) refuse<std::invalid_argument>("Gaussians are too far apart");
      s->context = map.context(map.spot());
      if (s == first) {
        models.turn<true, false>(coder, p, c, map, gap + on, begun, *s, *s);
      } else {
        models.turn<true, true>(coder, p, c, map, gap + on, begun, *s, s[-1]);
      }
      gap = 0;
    }
  }
  models.turn<false, true>(coder, p, c, map, 0, begun, end[-1], end[-1]);
}
#if SG_X86
template <auto body, typename... Arguments>
[[gnu::target("avx2,bmi,bmi2,lzcnt")]] auto with_bit_operations(Arguments... arguments) {
  return body(arguments...);
}
#endif
using EncodeClass = void (*)(Encoder&, Models&, const RdParameters&, DensityMap&, Symbols* first, Symbols* end);
EncodeClass best_encode_class() {
#if SG_X86
  if (best_isa() >= kAvx2 && has_bit_operations()) return with_bit_operations<encode_class_body>;
#endif
  return for_baseline<encode_class_body>;
}

}  // namespace

// Gaussians as they are decoded.
struct Decoded {
  GaussianArrays values;
  std::vector<double> strengths;  // of a class, for the map

  int count() const { return values.count(); }
};

namespace {

// The state of a decoder. With prefix = true, it goes up to the first Gaussian that needs more.
template <size_t kStates>
struct Decoding {
  using Coder = Decoder<kStates>;

  const RdParameters& p;
  const size_t size;
  const bool prefix;
  Decoded& out;
  const std::function<void(int)>& arrived;
  Coder coder;
  Models models{};
  DensityMap map{p.width, p.height};
  // A chunk, and behind it perhaps a Gaussian of which only the first half is decoded.
  Symbols symbols[kChunk + 1] = {};
  Parts parts[kChunk] = {};

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

// Decodes `wanted` Gaussians of a class, or less where a prefix ends: the first of the class if `begin`, not its last
// if `more`. begun: of the Gaussian behind them. Returns their number.
template <size_t kStates>
SG_INLINE int decode_chunk_body(Decoding<kStates>& d, Begun& begun, const SizeClass& c, int wanted, bool begin,
                                bool more) {
  auto coder = d.coder;  // copies, to be kept in registers
  Begun now = begun;
  const RdParameters p = d.p;
  const SizeClass by = c;
  Models& models = d.models;
  Symbols* s = d.symbols;
  int found = 0;
  d.attempt(coder, [&]() SG_INLINE_LAMBDA {
    s->size_class = by.number;
    if (begin) models.template turn<true, false>(coder, p, by, d.map, 0, now, *s, *s);
    for (const int turns = more ? wanted : wanted - 1; found < turns; ++found, ++s) {
      s[1].size_class = by.number;
      d.parts[found] = models.template turn<true, true>(coder, p, by, d.map, 0, now, s[1], s[0]);
      if (!d.whole(coder)) break;
    }
    if (!more && found == wanted - 1) {
      d.parts[found] = models.template turn<false, true>(coder, p, by, d.map, 0, now, *s, *s);
      found += d.whole(coder);
    }
  });
  begun = now;
  d.coder = coder;
  return found;
}

template <size_t kStates>
using DecodeChunk = int (*)(Decoding<kStates>&, Begun&, const SizeClass&, int wanted, bool begin, bool more);
template <size_t kStates>
DecodeChunk<kStates> best_decode_chunk() {
#if SG_X86
  if (best_isa() >= kAvx2 && has_bit_operations()) return with_bit_operations<decode_chunk_body<kStates>>;
#endif
  return for_baseline<decode_chunk_body<kStates>>;
}

template <size_t kStates>
size_t read_class(Decoding<kStates>& d, int size_class, uint32_t count, size_t room, bool maps) {
  static const auto decode_chunk = best_decode_chunk<kStates>();
  const SizeClass c = class_of(d.p, size_class);
  d.map.begin(size_class, count);
  d.out.strengths.clear();
  Begun begun;
  GaussianArrays& values = d.out.values;
  const auto first = static_cast<size_t>(d.out.count());
  size_t found = 0;
  while (found < room) {
    const int wanted = static_cast<int>(std::min<size_t>(room - found, kChunk));
    const int came = decode_chunk(d, begun, c, wanted, found == 0, found + static_cast<size_t>(wanted) < count);
    const size_t at = first + found;
    found += static_cast<size_t>(came);
    values.means.resize(2 * (first + found));
    values.factors.resize(3 * (first + found));
    values.colors.resize(3 * (first + found));
    dequantise(d.p, d.symbols, d.parts, came,
               {values.means.data() + 2 * at, values.factors.data() + 3 * at, values.colors.data() + 3 * at});
    if (maps)
      for (int i = 0; i < came; ++i) d.out.strengths.push_back(strength_of(d.symbols[i]));
    d.arrived(d.out.count());
    if (came < wanted) break;
    d.symbols[0] = d.symbols[kChunk];
  }
  if (maps)
    d.map.add(values.means.data() + 2 * first, values.factors.data() + 3 * first, d.out.strengths.data(),
              static_cast<int>(found));
  return found;
}

// Decodes a payload. False where a prefix ended. Throws std::runtime_error on what no encoder writes.
template <size_t kStates>
bool decode_payload(Decoding<kStates>& d, uint64_t limit) {
  const uint64_t at_most = max_gaussians_in(d.p, d.size);
  const bool begun = d.coder.begins();
  const int first = kMaxClass - static_cast<int>(code_class_number(d.coder));
  const int last = first - static_cast<int>(code_class_number(d.coder));
  if (d.prefix && d.overrun(d.coder)) return false;
  if (!begun || last < kMinClass) refuse<std::runtime_error>("no encoder begins like this");
  size_t done = 0;
  for (int c = first; c >= last; --c) {
    const uint32_t count = code_whole(d.coder, kColorState, d.models.count);
    if (!d.whole(d.coder)) return false;
    if (!d.prefix && count > at_most - done) refuse<std::runtime_error>("more Gaussians than the data can hold");
    const size_t room = std::min<uint64_t>(count, at_most - done);
    if (done + room > limit) refuse<std::overflow_error>("more Gaussians than the limit");
    if (count == 0) continue;
    const size_t found = read_class(d, c, std::min<uint32_t>(count, kMaxGaussians), room, is_mapped(d.p, c, last));
    done += found;
    if (found < count) return false;
  }
  if (!d.prefix && !d.coder.ends()) refuse<std::runtime_error>("the last Gaussian does not end as it should");
  return true;
}

template <size_t kStates>
void decode_into(const RdParameters& p, const uint8_t* data, size_t size, bool prefix, uint64_t limit, Decoded& out,
                 const std::function<void(int)>& arrived) {
  std::vector<uint8_t> padded(size + Decoder<kStates>::kSlack);
  std::copy_n(data, size, padded.begin());
  const std::unique_ptr<Decoding<kStates>> d(
      new Decoding<kStates>{p, size, prefix, out, arrived, Decoder<kStates>(padded.data())});
  const bool ended = decode_payload(*d, limit);
  const size_t read = std::min(d->coder.read(), size);
  if (ended && !prefix && std::any_of(data + read, data + size, [](uint8_t byte) { return byte != 0; }))
    refuse<std::runtime_error>("there are bytes behind the last Gaussian");
}

auto decode_into(const RdParameters& p) { return p.is_short ? decode_into<1> : decode_into<kRansStates>; }

void reserve(GaussianArrays& values, size_t n) {
  values.means.reserve(2 * n);
  values.factors.reserve(3 * n);
  values.colors.reserve(3 * n);
}

template <size_t n>
void start(Model (&models)[n], const uint8_t* rows) {
  for (size_t i = 0; i < n; ++i) models[i] = Model(kStarts[rows[i]]);
}
template <size_t n, size_t m>
void start(Model (&models)[n][m], const uint8_t* rows) {
  for (size_t i = 0; i < n; ++i) start(models[i], rows + m * i);
}
template <size_t n, size_t m, size_t k>
void start(Model (&models)[n][m][k], const uint8_t* rows) {
  for (size_t i = 0; i < n; ++i) start(models[i], rows + m * k * i);
}

}  // namespace

Models::Models(FromTables) : count(kStarts[kStartCount[0]]), distance(kStarts[kStartDistance[0]]) {
  start(luma_by_energy, kStartLumaByEnergy);
  start(luma_by_class, kStartLumaByClass);
  start(a, kStartA);
  start(a_by_class, kStartAByClass);
  start(b, kStartB);
  start(b_by_luma, kStartBByLuma);
  start(color_signs, kStartColorSigns);
  start(v, kStartV);
  start(v_by_class, kStartVByClass);
  start(r, kStartR);
  start(r_by_direction, kStartRByDirection);
  start(shape_signs, kStartShapeSigns);
}

const Models& Models::fresh() {
  static const Models models{FromTables{}};
  return models;
}

RdParameters::RdParameters(int width, int height, double quantum, bool grey, bool upright, bool is_short)
    : width(width), height(height), quantum(quantum), grey(grey), upright(upright), is_short(is_short) {
  if (!(width > 0 && height > 0 && quantum > 0)) refuse<std::invalid_argument>("parameters must be positive");
  if (width > kMaxSide || height > kMaxSide) refuse<std::invalid_argument>("a side is more than 65535 pixels");
}

std::vector<uint8_t> encode_symbols(const RdParameters& p, std::vector<Symbols>& all, Models& models) {
  if (all.empty()) return {};
  if (all.size() > max_gaussians_in(p, SIZE_MAX / 16))
    refuse<std::invalid_argument>("more Gaussians than pixels, or than 2^24");
  static const auto encode_class = best_encode_class();
  constexpr size_t kClasses = kMaxClass - kMinClass + 1;
  std::vector<Symbols> sorted(all.size());
  const auto class_number = [](const Symbols& s) { return static_cast<size_t>(kMaxClass - s.size_class); };
  sort_by(all.data(), all.size(), kClasses, class_number, sorted.data());
  Encoder coder(all.size());
  DensityMap map(p.width, p.height);
  const int first = sorted.front().size_class, last = sorted.back().size_class;
  code_class_number(coder, static_cast<uint32_t>(kMaxClass - first));
  code_class_number(coder, static_cast<uint32_t>(first - last));
  size_t at = 0;
  for (int c = first; c >= last; --c) {
    size_t end = at;
    while (end < all.size() && sorted[end].size_class == c) ++end;
    const auto n = static_cast<uint32_t>(end - at);
    code_whole(coder, kColorState, models.count, n);
    if (n == 0) continue;
    map.begin(c, n);
    sort_by(&sorted[at], n, map.blocks(), [&](const Symbols& s) { return block_of(map, s); }, &all[at]);
    encode_class(coder, models, p, map, &all[at], &all[at] + n);
    if (is_mapped(p, c, last)) add_class(map, p, &all[at], static_cast<int>(n));
    at = end;
  }
  return coder.finish(p.is_short ? 1 : kRansStates);
}

std::vector<uint8_t> rd_encode(const RdParameters& p, const ConstGaussians& gaussians, int n) {
  std::vector<Symbols> all = quantised(p, gaussians, n);
  Models models;
  return encode_symbols(p, all, models);
}

GaussianArrays rd_decode(const RdParameters& p, const uint8_t* data, size_t size, bool prefix, uint64_t max_gaussians) {
  Decoded out;
  if (size == 0) return {};
  reserve(out.values, std::min<uint64_t>(max_gaussians_in(p, size), size / 2));  // in 16 bits each
  decode_into(p)(p, data, size, prefix, max_gaussians, out, [](int) {});
  return std::move(out.values);
}

StreamingDecoder::StreamingDecoder(const RdParameters& p, size_t room) : p_(p), room_(room), decoded_(new Decoded) {
  reserve(decoded_->values, room);  // which never moves, since others read it
}
StreamingDecoder::~StreamingDecoder() = default;

void StreamingDecoder::decode(const uint8_t* data, size_t size, bool prefix, const std::function<void(int)>& arrived) {
  if (size > 0) decode_into(p_)(p_, data, size, prefix, room_, *decoded_, arrived);
}

ConstGaussians StreamingDecoder::values() const { return decoded_->values.rows(); }

}  // namespace sg
