// Profile rd: the adaptive models of a stream, and the one order in which a Gaussian's integers are coded, for the
// encoder, the decoder and the estimate of bits alike.
#pragma once

#include <algorithm>
#include <array>
#include <cstdlib>
#include <stdexcept>
#include <utility>

#include "rd/entropy_coder.h"
#include "rd/start_tables.h"
#include "rd/symbols.h"

namespace sg {

// A number below 2^32. Each of 0 to 3 has a symbol. So has each half of an octave up to 191, and the number's lower bits
// follow without a model. The last symbol is an escape: the length of a larger number and its bits follow.
constexpr uint32_t kEscape = 15, kFirstEscaped = 192;

template <typename Coder>
uint32_t code_bits(Coder& coder, uint32_t value, int count) {  // any number of bits
  uint32_t high = 0;
  if (count > 16) {
    high = coder.raw(value >> 16, count - 16) << 16;
    count = 16;
  }
  return high | coder.raw(value & ((1u << count) - 1), count);
}

template <typename Coder>
uint32_t code_number(Coder& coder, Model& model, uint32_t value = 0) {
  const int top = value == 0 ? 0 : 31 - __builtin_clz(value);
  uint32_t symbol = value < 4 ? value : value < kFirstEscaped ? 2u * top | ((value >> (top - 1)) & 1) : kEscape;
  symbol = static_cast<uint32_t>(coder.symbol(model, static_cast<int>(symbol)));
  if (symbol == kEscape) {
    const int bits = static_cast<int>(coder.raw(static_cast<uint32_t>(top), 5));
    return 1u << bits | code_bits(coder, value & ((1u << top) - 1), bits);
  }
  if (symbol < 4) return symbol;
  const int bits = static_cast<int>(symbol / 2) - 1;
  return (2 | (symbol & 1)) << bits | coder.raw(value & ((1u << bits) - 1), bits);
}

inline int level(uint32_t size) {  // of a magnitude, for contexts
  return size == 0 ? 0 : size <= 2 ? 1 : size <= 6 ? 2 : 3;
}

template <size_t... I>
std::array<Model, sizeof...(I)> models_from(const uint8_t (*start)[kSymbols - 1], std::index_sequence<I...>) {
  return {Model(start[I])...};
}
template <size_t N>
std::array<Model, N> models_from(const uint8_t (&start)[N][kSymbols - 1]) {
  return models_from(start, std::make_index_sequence<N>());
}

// There are few contexts, because a small picture has only a few hundred symbols for each to learn from. Contexts by size
// class, by the neighbour along the curve, and of r by v were measured and gained next to nothing (docs/design.md).
struct Models {
  Model count{kStartCount}, distance{kStartDistance}, luma{kStartLuma};
  std::array<Model, 4> a = models_from(kStartA), b = models_from(kStartB);
  std::array<Model, 8> color_signs = models_from(kStartColorSigns), v = models_from(kStartV), r = models_from(kStartR);
  std::array<Model, 4> shape_signs = models_from(kStartShapeSigns);

  // All but the cell.
  template <typename Coder>
  Geometry gaussian(Coder& coder, const RdParameters& p, Symbols& s) {
    const uint32_t y = code_number(coder, luma, magnitude(s.y));
    const uint32_t size_a = p.grey ? 0 : code_number(coder, a[level(y)], magnitude(s.a));
    const uint32_t size_b = p.grey ? 0 : code_number(coder, b[level(size_a)], magnitude(s.b));
    const int colored = (y != 0) << 2 | (size_a != 0) << 1 | (size_b != 0);
    if (colored == 0) throw std::runtime_error("a Gaussian has no colour");
    if (std::max({y, size_a, size_b}) > static_cast<uint32_t>(limits_of(p).color)) throw std::runtime_error("a colour is out of range");
    const int of_color = coder.symbol(color_signs[colored], (s.y < 0) << 2 | (s.a < 0) << 1 | (s.b < 0));
    s.y = with_sign(y, of_color & 4);
    s.a = with_sign(size_a, of_color & 2);
    s.b = with_sign(size_b, of_color & 1);
    const Steps steps(p, s);
    s.u = coder.raw(s.u, steps.u_bits());
    const uint32_t size_v = code_number(coder, v[steps.bucket()], magnitude(s.v));
    const uint32_t size_r = p.upright ? 0 : code_number(coder, r[steps.bucket()], magnitude(s.r));
    if (!steps.allow(size_v, size_r)) throw std::runtime_error("a shape is out of range");
    const int shaped = (size_v != 0) << 1 | (size_r != 0);
    const int of_shape = shaped ? coder.symbol(shape_signs[shaped], (s.v < 0) << 1 | (s.r < 0)) : 0;
    s.v = with_sign(size_v, of_shape & 2);
    s.r = with_sign(size_r, of_shape & 1);
    const Geometry geometry(s, steps);
    s.px = coder.raw(s.px, geometry.x_bits);
    s.py = coder.raw(s.py, geometry.y_bits);
    return geometry;
  }

  static uint32_t magnitude(int value) { return static_cast<uint32_t>(std::abs(value)); }
  static int with_sign(uint32_t size, int negative) { return negative ? -static_cast<int>(size) : static_cast<int>(size); }
};

// The payload's bytes. Sorts the Gaussians; `models` end as the last of them leaves them.
std::vector<uint8_t> encode_symbols(const RdParameters& p, std::vector<Symbols>& all, Models& models);

}  // namespace sg
