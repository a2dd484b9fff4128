#include "rd/symbols.h"

#include <atomic>
#include <cmath>

#include "core/isa.h"
#include "core/thread_pool.h"

namespace sg {
namespace {

constexpr double kMinScaleFloat = static_cast<float>(kMinScale);
// Cells beyond each edge of the picture. A centre further out is moved into the outermost of them. So is one that a
// 16-bit coordinate does not reach: this happens to the smallest classes at the far end of sides above 65,531 pixels.
constexpr int kBorderCells = 2;
constexpr int kChunk = 256;  // Gaussians of one task
std::atomic<int64_t> clipped_in_all{0};

typedef double Pair __attribute__((vector_size(16)));

// exp by halving and a Taylor polynomial, of a number or of each of a vector: the C library's last bit differs between
// machines.
template <typename T>
SG_INLINE T exact_exp(T x) {
  const T z = x / 1024.0;
  T e = 1.0 + z * (1.0 + z * (0.5 + z * (0.16666666666666666 + z * 0.041666666666666664)));
  for (int k = 0; k < 10; ++k) e *= e;
  return e;
}

SG_INLINE double class_size(int c) { return ((c & 1) ? 1.4142135623730951 : 1.0) * power_of_two((c - (c & 1)) / 2); }

// A colour along the axes of kColorBasis.
struct Luma {
  double y, a, b;
};
Luma to_luma(const float* c) {
  return {(c[0] + c[1] + c[2]) * kColorBasis[0][0], (c[0] - c[2]) * kColorBasis[1][0],
          (c[0] - 2.0 * c[1] + c[2]) * kColorBasis[2][0]};
}
SG_INLINE void to_rgb(const Luma& l, float* c) {
  const double y = l.y * kColorBasis[0][0], a = l.a * kColorBasis[1][0], b = l.b * kColorBasis[2][0];
  c[0] = static_cast<float>(y + a + b);
  c[1] = static_cast<float>(y - 2.0 * b);
  c[2] = static_cast<float>(y - a + b);
}

// Within the class.
SG_INLINE double shape_u(const Symbols& s, const Steps& steps) {
  return ((s.u + 0.5) * power_of_two(-steps.u_bits()) - 0.5) * kClassWidth;
}

double color_step(const RdParameters& p, int size_class) {
  return std::max(p.quantum / (class_size(size_class) * kColorScale), kMinColorStep);
}

// A coordinate of a mean, from that of its cell, the part of the cell, and by how many bits this is divided.
SG_INLINE float place(uint32_t cell, uint32_t part, int bits, double side) {
  return static_cast<float>((static_cast<double>(cell) - kBorderCells + (part + 0.5) * power_of_two(-bits)) * side);
}

}  // namespace

bool in_range(const float* l, const float* color) {
  const auto small = [](float v, double max) { return std::abs(v) <= 1.5 * max; };
  return small(l[1], kMaxSlant * l[2]) && small(l[0], kMaxScale) && small(l[2], kMaxScale) &&
         small(color[0], kMaxAmplitude) && small(color[1], kMaxAmplitude) && small(color[2], kMaxAmplitude);
}

Geometry::Geometry(const Symbols& s, const Steps& steps) {
  const double u = shape_u(s, steps), v = s.v * steps.v(), r = s.r * steps.r();
  const Pair e = exact_exp(Pair{u + v, u - v});
  const double size = class_size(s.size_class);
  l1 = std::max(size * e[0], kMinScaleFloat);
  l3 = std::max(size * e[1], kMinScaleFloat);
  l2 = r * l3;
  parts = parts_of(s, steps);
}

uint32_t cells_along(int side, int bits) {
  return static_cast<uint32_t>(std::min(((side - 1) >> bits) + 1 + 2 * kBorderCells, 1 << 16));
}

bool quantise(const RdParameters& p, const float* mean, const float* factor, const float* color, Symbols& s,
              int& clipped) {
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
  const double u = 0.5 * std::log(l1 * l3);
  s.size_class = static_cast<int>(within(std::round(u / kClassWidth), kMinClass, kMaxClass));
  const double step = color_step(p, s.size_class);
  const Luma l = to_luma(color);
  s.y = round_to(l.y / step, kMaxColor);
  s.a = p.grey ? 0 : round_to(l.a / step, kMaxColor);
  s.b = p.grey ? 0 : round_to(l.b / step, kMaxColor);
  if (s.empty()) return false;
  const Steps steps(s);
  const double levels = static_cast<double>(1u << steps.u_bits());
  const double level = std::floor(((u / kClassWidth - s.size_class) + 0.5) * levels);
  s.u = static_cast<uint32_t>(std::clamp(level, 0.0, levels - 1));
  s.v = round_to(0.5 * std::log(l1 / l3) / steps.v(), std::floor(kMaxV / steps.v()));
  // r is chosen for the slope l2 / l1 to be right with the l1 and l3 that are decoded. If r = l2 / l3 were rounded
  // instead, the rounding error of v would turn a slanted needle, and count 1 + r^2 times.
  s.r = 0;
  const Geometry flat(s, steps);
  s.r = p.upright ? 0 : round_to(factor[1] / l1 * (flat.l1 / flat.l3) / steps.r(), std::floor(kMaxR / steps.r()));
  const Parts parts = parts_of(s, steps);
  const int cell = cell_bits(s.size_class);
  const auto place = [&](double position, int side, int refine, uint32_t& part) {
    const double cells = position / (1 << cell) + kBorderCells;
    const auto c = static_cast<uint32_t>(within(std::floor(cells), 0.0, cells_along(side, cell) - 1.0));
    const double parts = static_cast<double>(1u << refine);
    const double inside = (cells - c) * parts;
    part = static_cast<uint32_t>(std::clamp(std::floor(inside), 0.0, parts - 1));
    return c;
  };
  s.column = place(mean[0], p.width, parts.x_bits, s.px);
  s.row = place(mean[1], p.height, parts.y_bits, s.py);
  return true;
}

void erase_empty(std::vector<Symbols>& all) {
  all.erase(std::remove_if(all.begin(), all.end(), [](const Symbols& s) { return s.empty(); }), all.end());
}

namespace {

// Calls visit(i, integers) for each Gaussian, in parallel; without integers where nothing is left of it. Returns the
// number of values that were moved.
template <typename Visit>
int64_t for_each_quantised(const RdParameters& p, const ConstGaussians& g, int n, const Visit& visit) {
  std::atomic<int64_t> clipped{0};
  parallel_each(n, kChunk, [&](int64_t i) {
    Symbols s{};
    int moved = 0;
    visit(i, quantise(p, g.means + 2 * i, g.factors + 3 * i, g.colors + 3 * i, s, moved) ? &s : nullptr);
    if (moved != 0) clipped.fetch_add(moved, std::memory_order_relaxed);
  });
  clipped_in_all.fetch_add(clipped, std::memory_order_relaxed);
  return clipped;
}

}  // namespace

void dequantise(const RdParameters& p, const Symbols& s, const Geometry& g, float* mean, float* factor, float* color) {
  const double side = power_of_two(cell_bits(s.size_class));
  mean[0] = place(s.column, s.px, g.parts.x_bits, side);
  mean[1] = place(s.row, s.py, g.parts.y_bits, side);
  factor[0] = static_cast<float>(g.l1);
  factor[1] = static_cast<float>(g.l2);
  factor[2] = static_cast<float>(g.l3);
  const double step = color_step(p, s.size_class);
  to_rgb({s.y * step, s.a * step, s.b * step}, color);
}

int64_t clipped_values() { return clipped_in_all.load(std::memory_order_relaxed); }

std::vector<Symbols> quantised(const RdParameters& p, const ConstGaussians& gaussians, int n) {
  std::vector<Symbols> all(n);
  for_each_quantised(p, gaussians, n, [&](int64_t i, const Symbols* s) {
    if (s) all[i] = *s;
  });
  erase_empty(all);
  return all;
}

int64_t rd_quantise(const RdParameters& p, const ConstGaussians& gaussians, int n, const MutableGaussians& out) {
  return for_each_quantised(p, gaussians, n, [&](int64_t i, const Symbols* s) {
    float *const mean = out.means + 2 * i, *const factor = out.factors + 3 * i, *const color = out.colors + 3 * i;
    if (s) {
      dequantise(p, *s, Geometry(*s, Steps(*s)), mean, factor, color);
    } else {
      std::copy_n(gaussians.means + 2 * i, 2, mean);
      std::copy_n(gaussians.factors + 3 * i, 3, factor);
      std::fill_n(color, 3, 0.0f);
    }
  });
}

namespace {

// Operation by operation what Geometry and dequantise() do of one Gaussian, in loops of which the compiler makes
// vectors.
SG_INLINE void dequantise_body(const RdParameters& p, const Symbols* all, const Parts* parts, int n,
                               const MutableGaussians& out) {
  constexpr int kBlock = 64, kClasses = kMaxClass - kMinClass + 1;
  double sizes[kClasses], color_steps[kClasses];
  for (int c = 0; c < kClasses; ++c) {
    sizes[c] = class_size(c + kMinClass);
    color_steps[c] = color_step(p, c + kMinClass);
  }
  for (int first = 0; first < n; first += kBlock) {
    const int count = std::min(kBlock, n - first);
    const Symbols* const s = all + first;
    const Parts* const part = parts + first;
    float *const mean = out.means + 2 * first, *const factor = out.factors + 3 * first;
    float* const color = out.colors + 3 * first;
    double l1[kBlock], l3[kBlock], slants[kBlock];
    for (int i = 0; i < count; ++i) {
      const Steps steps(s[i].y, s[i].a, s[i].b);
      const double u = shape_u(s[i], steps), v = s[i].v * steps.v();
      l1[i] = u + v;
      l3[i] = u - v;
      slants[i] = s[i].r * steps.r();
    }
    for (int i = 0; i < count; ++i) l1[i] = exact_exp(l1[i]);
    for (int i = 0; i < count; ++i) l3[i] = exact_exp(l3[i]);
    for (int i = 0; i < count; ++i) {
      const double size = sizes[s[i].size_class - kMinClass];
      const double across = std::max(size * l3[i], kMinScaleFloat);
      factor[3 * i] = static_cast<float>(std::max(size * l1[i], kMinScaleFloat));
      factor[3 * i + 1] = static_cast<float>(slants[i] * across);
      factor[3 * i + 2] = static_cast<float>(across);
    }
    for (int i = 0; i < count; ++i) {
      const double step = color_steps[s[i].size_class - kMinClass];
      to_rgb({s[i].y * step, s[i].a * step, s[i].b * step}, color + 3 * i);
    }
    for (int i = 0; i < count; ++i)
      mean[2 * i] = place(s[i].column, s[i].px, part[i].x_bits, power_of_two(cell_bits(s[i].size_class)));
    for (int i = 0; i < count; ++i)
      mean[2 * i + 1] = place(s[i].row, s[i].py, part[i].y_bits, power_of_two(cell_bits(s[i].size_class)));
  }
}

}  // namespace

void dequantise(const RdParameters& p, const Symbols* s, const Parts* parts, int n, const MutableGaussians& out) {
#if SG_X86
  if (best_isa() >= kAvx2) return for_avx2<dequantise_body>(p, s, parts, n, out);
#endif
  dequantise_body(p, s, parts, n, out);
}

}  // namespace sg
