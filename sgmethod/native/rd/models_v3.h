// Version 3 of profile rd: the order in which a Gaussian's integers are coded, with one state and raw bits in it.
#pragma once

#include "rd/entropy_coder_v3.h"
#include "rd/models.h"

namespace sg {

template <typename Coder>
uint32_t code_bits_v3(Coder& coder, uint32_t value, int count) {  // any number of bits
  uint32_t high = 0;
  if (count > 16) {
    high = coder.raw(value >> 16, count - 16) << 16;
    count = 16;
  }
  return high | coder.raw(value & ((1u << count) - 1), count);
}

template <typename Coder>
uint32_t code_number_v3(Coder& coder, ModelV3& model, uint32_t value = 0) {
  const int top = value == 0 ? 0 : 31 - __builtin_clz(value);
  const auto symbol = static_cast<uint32_t>(coder.symbol(model, static_cast<int>(symbol_of(value))));
  if (symbol == kEscape) {
    const int bits = static_cast<int>(coder.raw(static_cast<uint32_t>(top), 5));
    return 1u << bits | code_bits_v3(coder, value & ((1u << top) - 1), bits);
  }
  const int bits = kNumbers.bits[symbol];
  return kNumbers.least[symbol] | coder.raw(value & ((1u << bits) - 1), bits);
}

struct ModelsV3 : ModelTables<ModelV3> {
  // The Morton code of the next Gaussian of a class. Throws std::runtime_error if it has more than 32 bits.
  template <typename Coder>
  uint32_t cell(Coder& coder, int raw_bits, uint32_t from, uint32_t cell = 0) {
    const uint32_t by = cell - from;
    const uint64_t high = code_number_v3(coder, distance, by >> raw_bits);
    const uint64_t next = from + (high << raw_bits) + code_bits_v3(coder, by & ((1u << raw_bits) - 1), raw_bits);
    if (next > 0xFFFFFFFFull) refuse<std::runtime_error>("a position is out of range");
    return static_cast<uint32_t>(next);
  }

  // All but the cell.
  template <typename Coder>
  Geometry gaussian(Coder& coder, const RdParameters& p, Symbols& s) {
    const uint32_t y = code_number_v3(coder, luma, magnitude(s.y));
    const uint32_t size_a = p.grey ? 0 : code_number_v3(coder, a[level(y)], magnitude(s.a));
    const uint32_t size_b = p.grey ? 0 : code_number_v3(coder, b[level(size_a)], magnitude(s.b));
    check_color(p, y, size_a, size_b);
    const int colored = (y != 0) << 2 | (size_a != 0) << 1 | (size_b != 0);
    const auto of_color = static_cast<uint32_t>(coder.symbol(color_signs[colored], static_cast<int>(color_sign_bits(s))));
    s.y = with_sign(y, of_color & 4);
    s.a = with_sign(size_a, of_color & 2);
    s.b = with_sign(size_b, of_color & 1);
    const Steps steps(p, s);
    s.u = coder.raw(s.u, steps.u_bits());
    const uint32_t size_v = code_number_v3(coder, v[steps.bucket()], magnitude(s.v));
    const uint32_t size_r = p.upright ? 0 : code_number_v3(coder, r[steps.bucket()], magnitude(s.r));
    check_shape(steps, size_v, size_r);
    const int shaped = (size_v != 0) << 1 | (size_r != 0);
    const int of_shape = shaped ? coder.symbol(shape_signs[shaped], static_cast<int>(shape_sign_bits(s))) : 0;
    s.v = with_sign(size_v, of_shape & 2);
    s.r = with_sign(size_r, of_shape & 1);
    const Geometry geometry(s, steps);
    s.px = coder.raw(s.px, geometry.parts.x_bits);
    s.py = coder.raw(s.py, geometry.parts.y_bits);
    return geometry;
  }

 private:
  static int level(uint32_t size) { return size == 0 ? 0 : size <= 2 ? 1 : size <= 6 ? 2 : 3; }
};

}  // namespace sg
