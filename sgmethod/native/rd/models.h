// Profile rd: the adaptive models of a stream, and the one order in which integers are coded, for the encoder, the
// decoder and the estimate of bits alike.
#pragma once

#include <algorithm>

#include "core/errors.h"
#include "core/simd.h"
#include "rd/entropy_coder.h"
#include "rd/start_tables.h"
#include "rd/symbols.h"

namespace sg {

// A number below 2^32, as a hybrid integer (JPEG XL has similar ones). Each of 0 to 3 has a symbol. So has each half of
// an octave up to 191, and the number's lower bits follow without a model. The last symbol is an escape: the length of
// a larger number and its bits follow.
constexpr uint32_t kEscape = 15, kFirstEscaped = 192;

struct HybridUint {
  uint32_t symbol = 0, value = 0;
  int bits = 0;  // the lowest of the value, which are still to come
};

// The least number of each symbol but the escape, and how many bits follow.
struct HybridUintTable {
  uint8_t least[kSymbols] = {0, 1, 2, 3}, bits[kSymbols] = {};
  constexpr HybridUintTable() {
    for (int s = 4; s < static_cast<int>(kEscape); ++s) {
      bits[s] = static_cast<uint8_t>(s / 2 - 1);
      least[s] = static_cast<uint8_t>((2 | (s & 1)) << bits[s]);
    }
  }
};
inline constexpr HybridUintTable kHybridUints;

inline uint32_t symbol_of(uint32_t value) {
  if (value < 4) return value;
  if (value >= kFirstEscaped) return kEscape;
  const int top = 31 - __builtin_clz(value);
  return 2u * top | ((value >> (top - 1)) & 1);
}

template <typename Coder, typename Probabilities>
SG_INLINE HybridUint code_hybrid_uint(Coder& coder, RansState which, Probabilities&& model, uint32_t value = 0) {
  const int top = value == 0 ? 0 : 31 - __builtin_clz(value);
  const uint32_t symbol = coder.symbol(which, model, symbol_of(value));
  if (__builtin_expect(symbol == kEscape, 0)) {
    coder.fetch(5);
    const int bits = static_cast<int>(coder.raw(static_cast<uint32_t>(top), 5));
    coder.fetch(bits);
    return {symbol, 1u << bits | coder.raw(value & ((1u << top) - 1), bits), 0};
  }
  return {symbol, kHybridUints.least[symbol], kHybridUints.bits[symbol]};
}
// The bits that are still to come of a number, as part of those fetched.
template <typename Coder>
SG_INLINE void code_rest(Coder& coder, HybridUint& number, uint32_t value = 0) {
  number.value |= coder.raw(value & ((1u << number.bits) - 1), number.bits);
}
// A number by itself.
template <typename Coder>
uint32_t code_whole(Coder& coder, RansState which, Model& model, uint32_t value = 0) {
  HybridUint number = code_hybrid_uint(coder, which, model, value);
  coder.fetch(number.bits);
  code_rest(coder, number, value);
  return number.value;
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

// What is known of a Gaussian after the first half of its symbols: its colour before signs, and its part of a block.
struct Begun {
  uint32_t y = 0, a = 0, b = 0;
  Context context;
  Spot spot;
};

// What the Gaussians of a class share.
struct SizeClass {
  int number;
  uint32_t columns, rows;  // of cells
};

constexpr int kLowBits = 3;  // of a distance, which are sent without a model
constexpr int kBuckets = 8, kMagnitudes = 4, kFolds = 10, kShapeSteps = 6, kSlantSteps = 4;

// Tells only what is asked of a DensityMap while its class is coded.
struct NoWalk {};

// Most symbols have two models, of different contexts, and the mean of their probabilities: what the surroundings say,
// and what the Gaussian's own numbers say (docs/notebook/bitstream.md).
struct Models {
  Model count, distance, luma_by_energy[kEnergies], luma_by_class[14];
  Model a[kMagnitudes], a_by_class[kMagnitudes][4], b[kMagnitudes], b_by_luma[kMagnitudes][kMagnitudes];
  Model color_signs[8], v[kFolds][kBuckets], v_by_class[7][kBuckets];
  Model r[kBuckets][kShapeSteps], r_by_direction[kFolds][kBuckets][kSlantSteps], shape_signs[kDirections][4];

  // As a stream begins.
  Models() : Models(fresh()) {}

  // One turn. The Gaussians of a class come one after another, and each in two halves: part of a block and colour, then
  // shape and place. A turn has the former of one, `next`, and the latter of the Gaussian before it, `now`. Symbols of
  // the two alternate, and with them the states. One fetch() is for at most 56 raw bits. `gap` is the distance to
  // `next`; `begun` is of `now` at first, then of `next`. Returns the parts of `now`.
  template <bool kNext, bool kNow, typename Coder, typename Walk>
  SG_INLINE Parts turn(Coder& coder, const RdParameters& p, const SizeClass& c, Walk& walk, uint64_t gap, Begun& begun,
                       Symbols& next, Symbols& now) {
    const Steps steps(kNow ? begun.y : 1, begun.a, begun.b);
    const auto bucket = static_cast<size_t>(steps.bucket());
    const auto group = static_cast<size_t>(std::clamp(c.number - kMinClass, 0, 13));
    const Context of_now = begun.context;
    const Spot spot = begun.spot;
    Context of_next = next.context;
    HybridUint distance, y, a, b, v, r;
    Parts parts{};
    if constexpr (kNext && Coder::kCodesPlaces)
      distance = code_hybrid_uint(coder, kColorState, this->distance, static_cast<uint32_t>(gap >> kLowBits));
    if (kNow) {
      const size_t colored = (begun.y != 0) << 2 | (begun.a != 0) << 1 | (begun.b != 0);
      const uint32_t signs = coder.symbol(kShapeState, color_signs[colored], color_sign_bits(now));
      now.y = with_sign(begun.y, signs & 4);
      now.a = with_sign(begun.a, signs & 2);
      now.b = with_sign(begun.b, signs & 1);
    }
    if constexpr (kNext && Coder::kCodesPlaces) {
      coder.fetch(distance.bits + kLowBits);
      code_rest(coder, distance, static_cast<uint32_t>(gap >> kLowBits));
      const uint32_t low = coder.raw(static_cast<uint32_t>(gap) & ((1u << kLowBits) - 1), kLowBits);
      if constexpr (Coder::kDecodes) {
        if (!walk.advance(uint64_t{distance.value} << kLowBits | low))
          refuse<std::runtime_error>("a position is out of range");
        walk.count();
        begun.spot = walk.spot();
        of_next = walk.context(begun.spot);
      }
    }
    if (kNext)
      y = code_hybrid_uint(coder, kColorState, Mean(luma_by_energy[of_next.energy], luma_by_class[group]),
                           magnitude(next.y));
    const size_t fold = folded(of_now.direction);
    if (kNow)
      v = code_hybrid_uint(coder, kShapeState, Mean(this->v[fold][bucket], v_by_class[group / 2][bucket]),
                           magnitude(now.v));
    if (kNext && !p.grey) {
      const size_t luma = level(y);
      a = code_hybrid_uint(coder, kColorState, Mean(this->a[luma], a_by_class[luma][group / 4]), magnitude(next.a));
    }
    if (kNow && !p.upright) {
      const uint32_t s = v.symbol;
      const size_t steps_of_v = std::min((s + 1) / 2, kShapeSteps - 1u), slant = (s > 0) + (s > 3) + (s > 6);
      r = code_hybrid_uint(coder, kShapeState, Mean(this->r[bucket][steps_of_v], r_by_direction[fold][bucket][slant]),
                           magnitude(now.r));
    }
    if (kNext && !p.grey)
      b = code_hybrid_uint(coder, kColorState, Mean(this->b[level(a)], b_by_luma[level(a)][level(y)]),
                           magnitude(next.b));
    uint32_t shape_signs = 0;
    if (kNow) {
      const size_t shaped = (v.symbol != 0) << 1 | (r.symbol != 0);
      shape_signs = coder.symbol(kShapeState, this->shape_signs[of_now.direction][shaped], shape_sign_bits(now));
    }

    coder.fetch(v.bits + r.bits + (kNow ? steps.u_bits() : 0) + y.bits + a.bits + b.bits);
    if (kNow) {
      code_rest(coder, v, magnitude(now.v));
      code_rest(coder, r, magnitude(now.r));
      now.u = coder.raw(now.u, steps.u_bits());
      check_shape(steps, v.value, r.value);
      now.v = with_sign(v.value, shape_signs & 2);
      now.r = with_sign(r.value, shape_signs & 1);
      parts = parts_of(now, steps);
    }
    if (kNext) {
      code_rest(coder, y, magnitude(next.y));
      code_rest(coder, a, magnitude(next.a));
      code_rest(coder, b, magnitude(next.b));
      check_color(y.value, a.value, b.value);
      begun.y = y.value, begun.a = a.value, begun.b = b.value;
      begun.context = of_next;
    }
    if (kNow) {
      const int x_bits = std::max(parts.x_bits - of_now.x_bits, 0), y_bits = std::max(parts.y_bits - of_now.y_bits, 0);
      coder.fetch(x_bits + y_bits);
      code_place<Coder>(coder, x_bits, parts.x_bits, of_now.x_bits, spot.column, spot.x, now.column, now.px);
      code_place<Coder>(coder, y_bits, parts.y_bits, of_now.y_bits, spot.row, spot.y, now.row, now.py);
      if (Coder::kDecodes && (now.column >= c.columns || now.row >= c.rows))
        refuse<std::runtime_error>("a position is out of range");
    }
    return parts;
  }

 private:
  struct FromTables {};
  explicit Models(FromTables);
  static const Models& fresh();
  // Of a magnitude, for contexts; from its symbol, so that the next need not wait for raw bits.
  static SG_INLINE size_t level(const HybridUint& n) { return (n.symbol > 0) + (n.symbol > 2) + (n.symbol > 5); }
  // Directions that a mirror image has too: none, and for each coherence horizontal, diagonal and vertical.
  static SG_INLINE size_t folded(size_t direction) {
    if (direction < 2) return 0;
    const size_t octant = (direction - 2) % 8;
    return 1 + (direction - 2) / 8 * 3 + (octant % 2 == 1 ? 1 : octant % 4);
  }
  // Codes what its part does not tell of a place along one axis: the last `bits` of its cell's number and part.
  // of_cell: by how many bits a cell is divided; told: by how many the block's part has divided it, `part` its number.
  template <typename Coder>
  static SG_INLINE void code_place(Coder& coder, int bits, int of_cell, int told, int first, uint32_t part,
                                   uint32_t& cell, uint32_t& place) {
    const uint64_t all = uint64_t{cell - 2} << of_cell | place;
    const uint32_t low = coder.raw(static_cast<uint32_t>(all & ((uint64_t{1} << bits) - 1)), bits);
    if constexpr (Coder::kDecodes) {
      const uint64_t whole = bits > 0 ? uint64_t{part} << bits | low : uint64_t{part} >> (told - of_cell);
      cell = static_cast<uint32_t>(first) + static_cast<uint32_t>(whole >> of_cell);
      place = static_cast<uint32_t>(whole & ((uint64_t{1} << of_cell) - 1));
    }
  }
};

// The payload's bytes. Sorts the Gaussians; `models` end as the last of them leaves them.
std::vector<uint8_t> encode_symbols(const RdParameters& p, std::vector<Symbols>& all, Models& models);

}  // namespace sg
