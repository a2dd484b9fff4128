// Profile rd: the adaptive models of a stream, and the one order in which integers are coded, for the encoder, the
// decoder and the estimate of bits alike.
#pragma once

#include <algorithm>
#include <array>
#include <utility>

#include "core/errors.h"
#include "core/simd.h"
#include "rd/entropy_coder.h"
#include "rd/start_tables.h"
#include "rd/symbols.h"

namespace sg {

// A number below 2^32. Each of 0 to 3 has a symbol. So has each half of an octave up to 191, and the number's lower
// bits follow without a model. The last symbol is an escape: the length of a larger number and its bits follow.
constexpr uint32_t kEscape = 15, kFirstEscaped = 192;

struct Number {
  uint32_t symbol = 0, value = 0;
  int bits = 0;  // the lowest of the value, which are still to come
};

// The least number of each symbol but the escape, and how many bits follow.
struct NumberTable {
  uint8_t least[kSymbols] = {0, 1, 2, 3}, bits[kSymbols] = {};
  constexpr NumberTable() {
    for (int s = 4; s < static_cast<int>(kEscape); ++s) {
      bits[s] = static_cast<uint8_t>(s / 2 - 1);
      least[s] = static_cast<uint8_t>((2 | (s & 1)) << bits[s]);
    }
  }
};
inline constexpr NumberTable kNumbers;

inline uint32_t symbol_of(uint32_t value) {
  if (value < 4) return value;
  if (value >= kFirstEscaped) return kEscape;
  const int top = 31 - __builtin_clz(value);
  return 2u * top | ((value >> (top - 1)) & 1);
}

template <typename Coder>
SG_INLINE Number code_number(Coder& coder, Lane lane, Model& model, uint32_t value = 0) {
  const int top = value == 0 ? 0 : 31 - __builtin_clz(value);
  const uint32_t symbol = coder.symbol(lane, model, symbol_of(value));
  if (__builtin_expect(symbol == kEscape, 0)) {
    coder.fetch(5);
    const int bits = static_cast<int>(coder.raw(static_cast<uint32_t>(top), 5));
    coder.fetch(bits);
    return {symbol, 1u << bits | coder.raw(value & ((1u << top) - 1), bits), 0};
  }
  return {symbol, kNumbers.least[symbol], kNumbers.bits[symbol]};
}
// The bits that are still to come of a number, as part of those fetched.
template <typename Coder>
SG_INLINE void code_rest(Coder& coder, Number& number, uint32_t value = 0) {
  number.value |= coder.raw(value & ((1u << number.bits) - 1), number.bits);
}
// A number by itself.
template <typename Coder>
uint32_t code_whole(Coder& coder, Lane lane, Model& model, uint32_t value = 0) {
  Number number = code_number(coder, lane, model, value);
  coder.fetch(number.bits);
  code_rest(coder, number, value);
  return number.value;
}

template <size_t... I>
std::array<Model, sizeof...(I)> models_from(const uint8_t (*start)[kSymbols - 1], std::index_sequence<I...>) {
  return {Model(start[I])...};
}
template <size_t N>
std::array<Model, N> models_from(const uint8_t (&start)[N][kSymbols - 1]) {
  return models_from(start, std::make_index_sequence<N>());
}

inline uint32_t magnitude(int value) {
  return value < 0 ? 0u - static_cast<uint32_t>(value) : static_cast<uint32_t>(value);
}
SG_INLINE int with_sign(uint32_t size, uint32_t negative) {
  return negative ? -static_cast<int>(size) : static_cast<int>(size);
}
inline uint32_t color_sign_bits(const Symbols& s) { return (s.y < 0) << 2 | (s.a < 0) << 1 | (s.b < 0); }
inline uint32_t shape_sign_bits(const Symbols& s) { return (s.v < 0) << 1 | (s.r < 0); }

SG_INLINE void check_color(uint32_t y, uint32_t a, uint32_t b) {
  if ((y | a | b) == 0) refuse<std::runtime_error>("a Gaussian has no colour");
  if ((y | a | b) >= kFirstEscaped && std::max({y, a, b}) > static_cast<uint32_t>(kMaxColor))
    refuse<std::runtime_error>("a colour is out of range");
}
SG_INLINE void check_shape(const Steps& steps, uint32_t v, uint32_t r) {
  if (!steps.allow(v, r)) refuse<std::runtime_error>("a shape is out of range");
}

// What is known about a colour before its signs.
struct ColorSize {
  uint32_t y = 0, a = 0, b = 0;
};

constexpr uint32_t kRowBits = 0xAAAAAAAA;  // of a Morton code

// What the Gaussians of a class share.
struct SizeClass {
  int number;
  int raw_bits;                    // of the distance from cell to cell, which are sent without a model
  uint32_t last_column, last_row;  // of the cells, as bits of a Morton code
};

// There are few contexts, because a small picture has only a few hundred symbols for each to learn from. Contexts by
// size class, by the neighbour along the curve, and of r by v were measured and gained next to nothing
// (docs/notebook/bitstream.md).
struct Models {
  Model count{kStartCount}, distance{kStartDistance}, luma{kStartLuma};
  std::array<Model, 4> a = models_from(kStartA), b = models_from(kStartB);
  std::array<Model, 8> color_signs = models_from(kStartColorSigns), v = models_from(kStartV), r = models_from(kStartR);
  std::array<Model, 4> shape_signs = models_from(kStartShapeSigns);

  // One turn. The Gaussians of a class come one after another, and each in two parts: cell and colour, then shape and
  // place. A turn has the former of one, `next`, and the latter of the Gaussian before it, `now`, whose cell is `from`.
  // Symbols of the two alternate, and with them the lanes. What chooses a symbol's model should not wait for raw bits
  // of the same turn, and one fetch() is for at most 56 of these. `size` is of the colour of `now` at first, then of
  // `next`. Returns the parts of `now`.
  template <bool kNext, bool kNow, typename Coder>
  SG_INLINE Parts pair(Coder& coder, const RdParameters& p, const SizeClass& c, uint32_t from, ColorSize& size,
                       Symbols& next, Symbols& now) {
    const Steps steps(kNow ? size.y : 1, size.a, size.b);
    const auto bucket = static_cast<size_t>(steps.bucket());
    const uint32_t by = kNext ? next.cell - from : 0;
    Number distance, y, a, b, v, r;
    Parts parts{};
    if (kNext && Coder::kCodesCells) distance = code_number(coder, kColorLane, this->distance, by >> c.raw_bits);
    if (kNow) {
      const size_t colored = (size.y != 0) << 2 | (size.a != 0) << 1 | (size.b != 0);
      const uint32_t signs = coder.symbol(kShapeLane, color_signs[colored], color_sign_bits(now));
      now.y = with_sign(size.y, signs & 4);
      now.a = with_sign(size.a, signs & 2);
      now.b = with_sign(size.b, signs & 1);
    }
    if (kNext) y = code_number(coder, kColorLane, luma, magnitude(next.y));
    if (kNow) v = code_number(coder, kShapeLane, this->v[bucket], magnitude(now.v));
    if (kNext && !p.grey) a = code_number(coder, kColorLane, this->a[level(y)], magnitude(next.a));
    if (kNow && !p.upright) r = code_number(coder, kShapeLane, this->r[bucket], magnitude(now.r));
    if (kNext && !p.grey) b = code_number(coder, kColorLane, this->b[level(a)], magnitude(next.b));

    coder.fetch(v.bits + r.bits + (kNow ? steps.u_bits() : 0) + (kNext ? c.raw_bits : 0));
    if (kNow) {
      code_rest(coder, v, magnitude(now.v));
      code_rest(coder, r, magnitude(now.r));
      now.u = coder.raw(now.u, steps.u_bits());
      check_shape(steps, v.value, r.value);
      const size_t shaped = (v.value != 0) << 1 | (r.value != 0);
      const uint32_t signs = coder.symbol(kShapeLane, shape_signs[shaped], shape_sign_bits(now));
      now.v = with_sign(v.value, signs & 2);
      now.r = with_sign(r.value, signs & 1);
      parts = parts_of(now, steps);
    }
    const uint32_t low = kNext ? coder.raw(by & ((1u << c.raw_bits) - 1), c.raw_bits) : 0;

    coder.fetch(distance.bits + y.bits + a.bits + b.bits + parts.x_bits + parts.y_bits);
    if (kNext) {
      code_rest(coder, y, magnitude(next.y));
      code_rest(coder, a, magnitude(next.a));
      code_rest(coder, b, magnitude(next.b));
      check_color(y.value, a.value, b.value);
      size = {y.value, a.value, b.value};
      code_rest(coder, distance, by >> c.raw_bits);
      const uint64_t cell = from + (uint64_t{distance.value} << c.raw_bits) + low;
      if ((cell & ~uint64_t{kRowBits}) > c.last_column || (cell & kRowBits) > c.last_row)
        refuse<std::runtime_error>("a position is out of range");
      next.cell = static_cast<uint32_t>(cell);
    }
    if (kNow) {
      now.px = coder.raw(now.px, parts.x_bits);
      now.py = coder.raw(now.py, parts.y_bits);
    }
    return parts;
  }

 private:
  // Of a magnitude, for contexts; from its symbol, so that the next need not wait for raw bits.
  static SG_INLINE size_t level(const Number& n) { return (n.symbol > 0) + (n.symbol > 2) + (n.symbol > 5); }
};

// The payload's bytes. Sorts the Gaussians; `models` end as the last of them leaves them.
std::vector<uint8_t> encode_symbols(const RdParameters& p, std::vector<Symbols>& all, Models& models);

}  // namespace sg
