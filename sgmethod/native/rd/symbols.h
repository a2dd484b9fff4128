// Profile rd: one Gaussian <-> integers. All steps follow from what is already decoded, none is signalled.
//
// A change of any parameter changes the picture by an energy (sum of squares over pixels and channels). With the
// nominal size s of the Gaussian's class, its colour c and w = exp(-sigma), integrals of w^2 z^k over the plane give,
// for a step d of
//     a colour component          d^2 pi s^2
//     u = log sqrt(l1 l3)         d^2 pi s^2 |c|^2 2
//     v = log sqrt(l1 / l3)       d^2 pi s^2 |c|^2
//     r = l2 / l3                 d^2 pi s^2 |c|^2 / 4
//     the mean, in units of L     d^2 pi s^2 |c|^2 / 2
// Colours are coded in steps of quantum / (1.5 s), where sqrt(pi) for 1.5 would make the quantum's square the energy of
// a step. With m the length of the integer colour vector, steps of equal energy are then 0.707 / m in u, 1 / m in v, 2
// / m in r and 1.414 / m in the mean: only m decides.
#pragma once

#include <algorithm>
#include <cstdint>
#include <vector>

#include "core/constants.h"
#include "core/simd.h"
#include "rd/codec.h"
#include "rd/density_map.h"

namespace sg {

constexpr int kMinClass = -4, kMaxClass = 28;  // size 2^(class / 2) pixels
constexpr double kClassWidth = 0.34657359027997264;  // log(2) / 2: one class in u

// What the integers may be. The range of v and r ends at values that do not depend on the steps: a slanted needle in a
// fine file is what it is in a coarse one. Steps are no finer than single precision can use.
constexpr int kMaxColor = 1 << 22;  // of each part of a colour, in steps
constexpr int kMaxV = 8, kMaxR = 4096;  // of |v| and |r|
constexpr int kMaxExponent = 18;  // of the length of the colour vector, as far as it decides steps
constexpr int kMaxUBits = 12, kMaxPartBits = 16;  // by which a class, and a cell, are divided
constexpr double kMinColorStep = 1.0 / 65536;

// The integers of one Gaussian.
struct Symbols {
  int size_class;
  uint32_t column, row;  // of the cell
  int y, a, b;  // colour
  uint32_t u;  // within the class
  int v, r;
  uint32_t px, py;  // within the cell
  Context context;  // as of the last time it was coded

  bool empty() const { return y == 0 && a == 0 && b == 0; }  // nothing is left of it
};

// The steps that follow from the colour: the class's width halved u_bits() times for u, powers of two for v and r.
struct Steps {
  explicit Steps(const Symbols& s) : Steps(s.y, s.a, s.b) {}
  Steps(int64_t y, int64_t a, int64_t b) : square(static_cast<uint64_t>(y * y + a * a + b * b)) {
    const int nearest = (64 - __builtin_clzll(square)) >> 1;  // 2^(2 e - 1) <= m^2 < 2^(2 e + 1)
    exponent = std::min(nearest, kMaxExponent);
  }
  uint64_t square;  // m^2
  int exponent;  // of the power of two nearest to m
  int u_bits() const { return std::clamp(exponent - 1, 0, kMaxUBits); }  // 0.3466 / 2^bits against 0.707 / m
  double v() const { return power_of_two(-exponent); }
  double r() const { return kRStep * v(); }
  int bucket() const { return std::min(exponent, 7); }  // of m, for contexts
  // Whether there is a shape with these steps of v and r.
  bool allow(uint32_t v_steps, uint32_t r_steps) const {
    const auto within = [&](uint32_t steps, double max) { return steps <= static_cast<uint64_t>(max) << exponent; };
    return within(v_steps, kMaxV) && within(r_steps, kMaxR / kRStep);
  }
};

// By how many bits a cell is divided.
struct Parts {
  int x_bits, y_bits;
};

struct Geometry {
  Geometry(const Symbols& s, const Steps& steps);
  double l1, l2, l3;
  Parts parts;
};

// Side of a class's cell, a power of two.
inline int cell_bits(int size_class) { return std::max(0, (size_class + 1) / 2); }

// The parts come from integers alone, so that what follows need not wait for the geometry. Sizes are measured by the
// logarithms of their squares, in sixteenths.
inline int log_16(uint64_t x) {  // linear between powers of two
  const int zeros = __builtin_clzll(x);
  return 16 * (63 - zeros) + static_cast<int>((x << zeros) >> 59) - 16;
}
inline Parts parts_of(const Symbols& s, const Steps& steps) {
  constexpr int kLeast = -56;  // of kMinScale
  const int h = steps.exponent;
  const int64_t r = s.r;
  const int u = static_cast<int>(((2 * s.u + 1) << 3) >> steps.u_bits()) - 8;
  const int v = static_cast<int>(46 * int64_t{s.v} >> h);  // 32 / log(2)
  const int slant = log_16((uint64_t{1} << 2 * h) + 4 * static_cast<uint64_t>(r * r)) - 32 * h;  // 1 + (l2 / l3)^2
  const int fineness = log_16(steps.square) + 32 * cell_bits(s.size_class) - 17;
  const auto bits = [&](int step) { return std::clamp(((fineness - step) >> 5) + 1, 0, kMaxPartBits); };
  const int size = 16 * s.size_class + u;
  return {bits(std::max(size + v, kLeast) - slant), bits(std::max(size - v, kLeast))};
}

// Cells along a side of the picture: those that touch it and two beyond each edge.
uint32_t cells_along(int side, int bits);

// What fits keep to, so that no range is ever left: within kMaxSlant, kMaxAmplitude and kMaxScale (constants.h),
// with room for the steps that refining takes.
bool in_range(const float* factor, const float* color);

// Rounds one Gaussian to integers. False if nothing of it is left. What lies outside of the range of its integer is
// moved to its end, and added to `clipped`.
bool quantise(const RdParameters& p, const float* mean, const float* factor, const float* color, Symbols& s,
              int& clipped);
inline bool quantise(const RdParameters& p, const float* mean, const float* factor, const float* color, Symbols& s) {
  int clipped = 0;
  return quantise(p, mean, factor, color, s, clipped);
}
void erase_empty(std::vector<Symbols>& all);
// What is left of n Gaussians.
std::vector<Symbols> quantised(const RdParameters& p, const ConstGaussians& gaussians, int n);
// The values that decoding an encoding of the given Gaussians would give, in the order given; Gaussians whose colour
// rounds to nothing get colour 0. Returns the number of values that were moved to the end of their range.
int64_t rd_quantise(const RdParameters& p, const ConstGaussians& gaussians, int n, const MutableGaussians& out);
// Number of values that lay outside of the range of their integer and were moved to its end since the process began, of
// Gaussians that were quantised, encoded or refined.
int64_t clipped_values();

void dequantise(const RdParameters& p, const Symbols& s, const Geometry& g, float* mean, float* factor, float* color);
// The same of n Gaussians whose parts are known, in vectors.
void dequantise(const RdParameters& p, const Symbols* s, const Parts* parts, int n, const MutableGaussians& out);

}  // namespace sg
