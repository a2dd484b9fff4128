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
// Colours are coded in steps of quantum / (1.5 s), where sqrt(pi) for 1.5 would make the quantum's square the energy of a
// step. With m the length of the integer colour vector, steps of equal energy are then 0.707 / m in u, 1 / m in v, 2 / m in
// r and 1.414 / m in the mean: only m decides.
#pragma once

#include <algorithm>
#include <cstdint>
#include <vector>

#include "core/constants.h"
#include "rd/codec.h"

namespace sg {

constexpr int kMinClass = -4, kMaxClass = 28;  // size 2^(class / 2) pixels
constexpr int kMaxColor = 1 << 20, kMaxShape = 1 << 16;
constexpr double kMaxAspect = 20.0;  // of v: exp(20) is beyond any picture

// The integers of one Gaussian.
struct Symbols {
  int size_class;
  uint32_t cell;  // Morton code
  int y, a, b;    // colour
  uint32_t u;     // within the class
  int v, r;
  uint32_t px, py;  // within the cell

  bool empty() const { return y == 0 && a == 0 && b == 0; }  // nothing is left of it
};

// The steps that follow from the colour: the class's width halved u_bits() times for u, powers of two for v and r.
struct Steps {
  explicit Steps(const Symbols& s);
  double square;  // m^2
  int exponent;   // of the power of two nearest to m
  int u_bits() const { return std::clamp(exponent - 1, 0, 8); }  // 0.3466 / 2^bits against 0.707 / m
  double v() const { return power(-exponent); }
  double r() const { return kRStep * v(); }
  int bucket() const { return std::min(exponent, 7); }  // of m, for contexts
  static double power(int exponent);                    // of two
};

struct Geometry {
  Geometry(const Symbols& s, const Steps& steps);
  double l1, l2, l3;
  int x_bits, y_bits;  // by which the cell is divided
};

// Side of a class's cell, a power of two.
inline int cell_bits(int size_class) { return std::max(0, (size_class + 1) / 2); }
// Cells along a side of the picture: those that touch it and two beyond each edge.
uint32_t cells_along(int side, int bits);
bool in_grid(const RdParameters& p, int bits, uint32_t cell);

// Rounds one Gaussian to integers. False if nothing of it is left.
bool quantise(const RdParameters& p, const float* mean, const float* factor, const float* color, Symbols& s);
void erase_empty(std::vector<Symbols>& all);
// What is left of n Gaussians.
std::vector<Symbols> quantised(const RdParameters& p, const float* means, const float* factors, const float* colors, int n);
void dequantise(const RdParameters& p, const Symbols& s, const Geometry& g, float* mean, float* factor, float* color);

}  // namespace sg
