// Version 3 of profile rd: the order in which a Gaussian's integers are coded, with one state and raw bits in it.
#pragma once

#include "rd/entropy_coder_v3.h"
#include "rd/models.h"

namespace sg {

inline uint32_t bits_v3(DecoderV3& coder, int count) {  // any number of bits
  uint32_t high = 0;
  if (count > 16) {
    high = coder.raw(count - 16) << 16;
    count = 16;
  }
  return high | coder.raw(count);
}

inline uint32_t number_v3(DecoderV3& coder, ModelV3& model) {
  const auto symbol = static_cast<uint32_t>(coder.symbol(model));
  if (symbol == kEscape) {
    const int bits = static_cast<int>(coder.raw(5));
    return 1u << bits | bits_v3(coder, bits);
  }
  return kNumbers.least[symbol] | coder.raw(kNumbers.bits[symbol]);
}

struct ModelsV3 : ModelTables<ModelV3> {
  // The Morton code of the next Gaussian of a class. Throws std::runtime_error if it has more than 32 bits.
  uint32_t cell(DecoderV3& coder, int raw_bits, uint32_t from) {
    const uint64_t high = number_v3(coder, distance);
    const uint64_t next = from + (high << raw_bits) + bits_v3(coder, raw_bits);
    if (next > 0xFFFFFFFFull) refuse<std::runtime_error>("a position is out of range");
    return static_cast<uint32_t>(next);
  }

  // All but the cell.
  void gaussian(DecoderV3& coder, const RdParameters& p, Symbols& s) {
    const uint32_t y = number_v3(coder, luma);
    const uint32_t size_a = p.grey ? 0 : number_v3(coder, a[level(y)]);
    const uint32_t size_b = p.grey ? 0 : number_v3(coder, b[level(size_a)]);
    check_color(p, y, size_a, size_b);
    const int colored = (y != 0) << 2 | (size_a != 0) << 1 | (size_b != 0);
    const auto of_color = static_cast<uint32_t>(coder.symbol(color_signs[colored]));
    s.y = with_sign(y, of_color & 4);
    s.a = with_sign(size_a, of_color & 2);
    s.b = with_sign(size_b, of_color & 1);
    const Steps steps(p, s);
    s.u = coder.raw(steps.u_bits());
    const uint32_t size_v = number_v3(coder, v[steps.bucket()]);
    const uint32_t size_r = p.upright ? 0 : number_v3(coder, r[steps.bucket()]);
    check_shape(steps, size_v, size_r);
    const int shaped = (size_v != 0) << 1 | (size_r != 0);
    const int of_shape = shaped ? coder.symbol(shape_signs[shaped]) : 0;
    s.v = with_sign(size_v, of_shape & 2);
    s.r = with_sign(size_r, of_shape & 1);
    const Geometry geometry(s, steps);
    s.px = coder.raw(geometry.parts.x_bits);
    s.py = coder.raw(geometry.parts.y_bits);
  }

 private:
  static int level(uint32_t size) { return size == 0 ? 0 : size <= 2 ? 1 : size <= 6 ? 2 : 3; }
};

}  // namespace sg
