#include "rd/symbols.h"

#include <cmath>
#include <cstring>

#include "core/constants.h"

namespace sg {
namespace {

constexpr double kClassWidth = 0.34657359027997264;  // log(2) / 2: one class in u
constexpr double kLeastScale = static_cast<float>(kMinScale);
// Cells beyond each edge of the picture. A centre further out is moved into the outermost of them. So is one that a
// 16-bit coordinate does not reach: this happens to the smallest classes at the far end of sides above 65,531 pixels.
constexpr int kBorderCells = 2;

typedef double Pair __attribute__((vector_size(16)));

// exp of both by halving and a Taylor polynomial: the C library's last bit differs between machines.
Pair exact_exp(Pair x) {
  const Pair z = x / 1024.0;
  Pair e = 1.0 + z * (1.0 + z * (0.5 + z * (0.16666666666666666 + z * 0.041666666666666664)));
  for (int k = 0; k < 10; ++k) e *= e;
  return e;
}

double class_size(int c) { return ((c & 1) ? 1.4142135623730951 : 1.0) * Steps::power((c - (c & 1)) / 2); }

// A colour along the axes of kColorBasis.
struct Luma {
  double y, a, b;
};
Luma to_luma(const float* c) {
  return {(c[0] + c[1] + c[2]) * kColorBasis[0][0], (c[0] - c[2]) * kColorBasis[1][0],
          (c[0] - 2.0 * c[1] + c[2]) * kColorBasis[2][0]};
}
void to_rgb(const Luma& l, float* c) {
  const double y = l.y * kColorBasis[0][0], a = l.a * kColorBasis[1][0], b = l.b * kColorBasis[2][0];
  c[0] = static_cast<float>(y + a + b);
  c[1] = static_cast<float>(y - 2.0 * b);
  c[2] = static_cast<float>(y - a + b);
}

uint32_t spread_bits(uint32_t v) {
  v = (v | v << 8) & 0x00FF00FF;
  v = (v | v << 4) & 0x0F0F0F0F;
  v = (v | v << 2) & 0x33333333;
  return (v | v << 1) & 0x55555555;
}
uint32_t gather_bits(uint32_t v) {
  v &= 0x55555555;
  v = (v | v >> 1) & 0x33333333;
  v = (v | v >> 2) & 0x0F0F0F0F;
  v = (v | v >> 4) & 0x00FF00FF;
  return (v | v >> 8) & 0x0000FFFF;
}

// Bits by which a cell is divided so that a part is at most one step: the first power of two above sqrt(square).
int refine_bits(double square, int most) {
  uint64_t bits;
  std::memcpy(&bits, &square, sizeof bits);  // positive and normal
  const int exponent = static_cast<int>(bits >> 52) - 1023;
  return std::clamp((exponent >> 1) + 1, 0, most);
}

double color_step(const RdParameters& p, int size_class) {
  return std::max(p.quantum / (class_size(size_class) * kColorScale), limits_of(p).color_step);
}

}  // namespace

double Steps::power(int exponent) {
  const uint64_t bits = static_cast<uint64_t>(1023 + exponent) << 52;
  double value;
  std::memcpy(&value, &bits, sizeof value);
  return value;
}

bool in_range(const float* l, const float* color) {
  const auto small = [](float v, double most) { return std::abs(v) <= 1.5 * most; };
  return small(l[1], kMaxSlant * l[2]) && small(l[0], kMaxScale) && small(l[2], kMaxScale) && small(color[0], kMaxAmplitude) &&
         small(color[1], kMaxAmplitude) && small(color[2], kMaxAmplitude);
}

Steps::Steps(const RdParameters& p, const Symbols& s) : limits(limits_of(p)) {
  const int64_t whole = int64_t{s.y} * s.y + int64_t{s.a} * s.a + int64_t{s.b} * s.b;
  square = static_cast<double>(whole);
  const int nearest = (64 - __builtin_clzll(static_cast<uint64_t>(whole))) >> 1;  // 2^(2 e - 1) <= m^2 < 2^(2 e + 1)
  exponent = std::min(nearest, limits.exponent);
}

Geometry::Geometry(const Symbols& s, const Steps& steps) {
  const double u = ((s.u + 0.5) * Steps::power(-steps.u_bits()) - 0.5) * kClassWidth;
  const double v = s.v * steps.v(), r = s.r * steps.r();
  const double size = class_size(s.size_class);
  const Pair e = exact_exp(Pair{u + v, u - v});
  l1 = std::max(size * e[0], kLeastScale);
  l3 = std::max(size * e[1], kLeastScale);
  l2 = r * l3;
  // (side / (sqrt(2) / m scale))^2
  const double square = steps.square * Steps::power(2 * cell_bits(s.size_class) - 1);
  x_bits = refine_bits(square * (1.0 + r * r) / (l1 * l1), steps.limits.part_bits);
  y_bits = refine_bits(square / (l3 * l3), steps.limits.part_bits);
}

uint32_t cells_along(int side, int bits) {
  return static_cast<uint32_t>(std::min((side >> bits) + 1 + 2 * kBorderCells, 1 << 16));
}

bool in_grid(const RdParameters& p, int bits, uint32_t cell) {
  return gather_bits(cell) < cells_along(p.width, bits) && gather_bits(cell >> 1) < cells_along(p.height, bits);
}

bool quantise(const RdParameters& p, const float* mean, const float* factor, const float* color, Symbols& s, int& clipped) {
  const double l1 = factor[0], l3 = factor[2];
  const auto finite = [](const float* values, int n) {
    return std::all_of(values, values + n, [](float v) { return std::isfinite(v); });
  };
  if (!finite(mean, 2) || !finite(factor, 3) || !finite(color, 3) || !(l1 > 0 && l3 > 0)) return false;
  const auto within = [&](double value, double low, double high) {
    clipped += value < low || value > high;
    return std::clamp(value, low, high);
  };
  const auto round_to = [&](double v, double limit) { return static_cast<int>(within(std::round(v), -limit, limit)); };
  const Limits& limits = limits_of(p);
  const double u = 0.5 * std::log(l1 * l3);
  s.size_class = static_cast<int>(within(std::round(u / kClassWidth), kMinClass, kMaxClass));
  const double step = color_step(p, s.size_class);
  const Luma l = to_luma(color);
  s.y = round_to(l.y / step, limits.color);
  s.a = p.grey ? 0 : round_to(l.a / step, limits.color);
  s.b = p.grey ? 0 : round_to(l.b / step, limits.color);
  if (s.empty()) return false;
  const Steps steps(p, s);
  const double levels = static_cast<double>(1u << steps.u_bits());
  s.u = static_cast<uint32_t>(std::clamp(std::floor(((u / kClassWidth - s.size_class) + 0.5) * levels), 0.0, levels - 1));
  const auto most = [&](double value, double of_step) { return std::min(std::floor(value / of_step), limits.shape_steps); };
  s.v = round_to(0.5 * std::log(l1 / l3) / steps.v(), most(limits.v, steps.v()));
  // r is chosen for the slope l2 / l1 to be right with the l1 and l3 that are decoded. If r = l2 / l3 were rounded instead,
  // the rounding error of v would turn a slanted needle, and count 1 + r^2 times.
  s.r = 0;
  const Geometry flat(s, steps);
  s.r = p.upright ? 0 : round_to(factor[1] / l1 * (flat.l1 / flat.l3) / steps.r(), most(limits.r, steps.r()));
  const Geometry g(s, steps);
  const int cell = cell_bits(s.size_class);
  const auto place = [&](double position, int side, int refine, uint32_t& part) {
    const double cells = position / (1 << cell) + kBorderCells;
    const auto c = static_cast<uint32_t>(within(std::floor(cells), 0.0, cells_along(side, cell) - 1.0));
    const double parts = static_cast<double>(1u << refine);
    const double inside = (cells - c) * parts;
    part = static_cast<uint32_t>(std::clamp(std::floor(inside), 0.0, parts - 1));
    return c;
  };
  const uint32_t cx = place(mean[0], p.width, g.x_bits, s.px), cy = place(mean[1], p.height, g.y_bits, s.py);
  s.cell = spread_bits(cx) | spread_bits(cy) << 1;
  return true;
}

void erase_empty(std::vector<Symbols>& all) {
  all.erase(std::remove_if(all.begin(), all.end(), [](const Symbols& s) { return s.empty(); }), all.end());
}

void dequantise(const RdParameters& p, const Symbols& s, const Geometry& g, float* mean, float* factor, float* color) {
  const double side = Steps::power(cell_bits(s.size_class));
  const auto place = [&](uint32_t cell, uint32_t part, int refine) {
    return static_cast<float>((static_cast<double>(cell) - kBorderCells + (part + 0.5) * Steps::power(-refine)) * side);
  };
  mean[0] = place(gather_bits(s.cell), s.px, g.x_bits);
  mean[1] = place(gather_bits(s.cell >> 1), s.py, g.y_bits);
  factor[0] = static_cast<float>(g.l1);
  factor[1] = static_cast<float>(g.l2);
  factor[2] = static_cast<float>(g.l3);
  const double step = color_step(p, s.size_class);
  to_rgb({s.y * step, s.a * step, s.b * step}, color);
}

}  // namespace sg
