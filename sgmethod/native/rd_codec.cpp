// The stream of profile rd. All steps follow from what is already decoded, none is signalled.
//
// A change of any parameter changes the picture by an energy (sum of squares over pixels and channels). With the
// nominal size s of the Gaussian's class, its colour c and w = exp(-sigma), integrals of w^2 z^k over the plane give,
// for a step d of
//     a colour component          d^2 pi s^2
//     u = log sqrt(l1 l3)         d^2 pi s^2 |c|^2 2
//     v = log sqrt(l1 / l3)       d^2 pi s^2 |c|^2
//     r = l2 / l3                 d^2 pi s^2 |c|^2 / 4
//     the mean, in units of L     d^2 pi s^2 |c|^2 / 2
// Colours are coded in steps of quantum / (s sqrt(pi)). With m the length of the integer colour vector, steps of
// equal energy are then 0.707 / m in u, 1 / m in v, 2 / m in r and 1.414 / m in the mean: only m decides.
//
// Order: classes of size from the largest down; within a class Gaussians by the Morton code of their cell, which is
// about as wide as they are. A cell's position is coded as the distance along that curve, which spends nothing on the
// order of a set; then come colour, u within its class, v, r, and the position within the cell.
#include "rd_codec.h"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <stdexcept>

#include "range_coder.h"

namespace sg {
namespace {

constexpr int kMinClass = -4, kMaxClass = 28;  // size 2^(class / 2) pixels
constexpr double kClassWidth = 0.34657359027997264;  // log(2) / 2: one class in u
constexpr double kSqrtPi = 1.7724538509055160;
constexpr float kMinScale = 0.3f;
constexpr int kMaxColor = 1 << 20, kMaxShape = 1 << 16;
constexpr double kMaxAspect = 20.0;  // of v: exp(20) is beyond any picture
constexpr int kMaxRefineBits = 12;
constexpr uint64_t kMaxGaussians = 1 << 24;

// exp(x) by halving and a Taylor polynomial: the C library's last bit differs between machines.
double exact_exp(double x) {
  const double y = x / 1024.0;
  double value = 1.0;
  for (int k = 12; k > 0; --k) value = 1.0 + value * y / k;
  for (int k = 0; k < 10; ++k) value *= value;
  return value;
}

double class_size(int c) {
  const double root = (c & 1) ? 1.4142135623730951 : 1.0;
  return std::ldexp(root, (c - (c & 1)) / 2);
}

// Side of a class's position cell, a power of two.
int cell_bits(int c) { return std::max(0, (c + 1) / 2); }

// Colours in an orthonormal basis (a DCT over the three channels): equal steps are equal errors in RGB.
struct Luma {
  double y, a, b;
};
Luma to_luma(const float* c) {
  return {(c[0] + c[1] + c[2]) * 0.57735026918962576, (c[0] - c[2]) * 0.70710678118654752,
          (c[0] - 2.0 * c[1] + c[2]) * 0.40824829046386302};
}
void to_rgb(const Luma& l, float* c) {
  const double y = l.y * 0.57735026918962576, a = l.a * 0.70710678118654752, b = l.b * 0.40824829046386302;
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

// The integers of one Gaussian.
struct Symbols {
  int size_class;
  uint32_t cell;  // Morton code
  int y, a, b;    // colour
  uint32_t u;     // within the class
  int v, r;
  uint32_t px, py;  // within the cell
};

// Steps that follow from the colour: halvings of the class width, and powers of two for v and r.
struct Shape {
  int u_bits;
  double v_step, r_step, m;
  int bucket;  // of m, for contexts
};
Shape shape_of(const Symbols& s) {
  const double square = static_cast<double>(s.y) * s.y + static_cast<double>(s.a) * s.a + static_cast<double>(s.b) * s.b;
  Shape shape;
  shape.m = std::sqrt(square);
  int exponent;  // m = fraction 2^exponent, fraction in [0.5, 1); rounded to the nearest power by sqrt(0.5)
  const double fraction = std::frexp(shape.m, &exponent);
  const int rounded = fraction < 0.70710678118654752 ? exponent - 1 : exponent;
  shape.v_step = std::ldexp(1.0, -rounded);
  shape.r_step = std::ldexp(2.0, -rounded);
  shape.u_bits = std::clamp(rounded - 1, 0, 8);  // 0.3466 / 2^bits against 0.707 / m
  shape.bucket = std::clamp(rounded, 0, 7);
  return shape;
}

struct Geometry {
  double l1, l2, l3;
};
Geometry geometry_of(const Symbols& s, const Shape& shape) {
  const double u = ((s.u + 0.5) / (1u << shape.u_bits) - 0.5) * kClassWidth;
  const double v = s.v * shape.v_step, r = s.r * shape.r_step;
  const double size = class_size(s.size_class);
  Geometry g;
  g.l1 = std::max(size * exact_exp(u + v), static_cast<double>(kMinScale));
  g.l3 = std::max(size * exact_exp(u - v), static_cast<double>(kMinScale));
  g.l2 = r * g.l3;
  return g;
}

// Bits by which a cell of `side` pixels is divided so that a part is at most about `step` pixels.
int refine_bits(double side, double step) {
  int exponent;
  std::frexp(side / step, &exponent);
  return std::clamp(exponent, 0, kMaxRefineBits);
}
struct Refinement {
  int x, y;
};
Refinement refinement_of(const Symbols& s, const Shape& shape, const Geometry& g) {
  const double side = std::ldexp(1.0, cell_bits(s.size_class));
  const double r = s.r * shape.r_step;
  const double unit = 1.4142135623730951 / shape.m;
  return {refine_bits(side, unit * g.l1 / std::sqrt(1.0 + r * r)), refine_bits(side, unit * g.l3)};
}

// Cells along a side: those that touch the picture and two beyond each edge. Centres further out are moved there, as
// are those that a 16-bit coordinate does not reach (the smallest classes at the end of sides above 65,531 pixels).
constexpr int kBorderCells = 2;
uint32_t cells_along(int side, int bits) {
  return static_cast<uint32_t>(std::min((side >> bits) + 1 + 2 * kBorderCells, 1 << 16));
}
uint32_t cell_coordinate(double position, int bits, int side) {
  const double cell = std::floor(position / (1 << bits)) + kBorderCells;
  return static_cast<uint32_t>(std::clamp(cell, 0.0, cells_along(side, bits) - 1.0));
}
bool in_grid(const RdParameters& p, int bits, uint32_t cell) {
  return gather_bits(cell) < cells_along(p.width, bits) && gather_bits(cell >> 1) < cells_along(p.height, bits);
}

// Rounds one Gaussian to integers. False if nothing of it is left.
bool quantise(const RdParameters& p, const float* mean, const float* factor, const float* color, Symbols& s) {
  const double l1 = factor[0], l3 = factor[2];
  const auto finite = [](const float* values, int n) { return std::all_of(values, values + n, [](float v) { return std::isfinite(v); }); };
  if (!finite(mean, 2) || !finite(factor, 3) || !finite(color, 3) || !(l1 > 0 && l3 > 0)) return false;
  const double u = 0.5 * std::log(l1 * l3);
  s.size_class = std::clamp(static_cast<int>(std::lround(u / kClassWidth)), kMinClass, kMaxClass);
  const double color_step = p.quantum / (class_size(s.size_class) * kSqrtPi);
  const Luma l = to_luma(color);
  const auto round_to = [](double v, double limit) { return static_cast<int>(std::clamp(std::round(v), -limit, limit)); };
  s.y = round_to(l.y / color_step, kMaxColor);
  s.a = p.grey ? 0 : round_to(l.a / color_step, kMaxColor);
  s.b = p.grey ? 0 : round_to(l.b / color_step, kMaxColor);
  if (s.y == 0 && s.a == 0 && s.b == 0) return false;
  const Shape shape = shape_of(s);
  const double levels = static_cast<double>(1u << shape.u_bits);
  s.u = static_cast<uint32_t>(std::clamp(std::floor(((u / kClassWidth - s.size_class) + 0.5) * levels), 0.0, levels - 1));
  s.v = round_to(0.5 * std::log(l1 / l3) / shape.v_step, std::min(std::floor(kMaxAspect / shape.v_step), 1.0 * kMaxShape));
  s.r = p.upright ? 0 : round_to(factor[1] / l3 / shape.r_step, kMaxShape);
  const Refinement bits = refinement_of(s, shape, geometry_of(s, shape));
  const int cell = cell_bits(s.size_class);
  const auto place = [&](double position, int side, int refine, uint32_t& part) {
    const uint32_t c = cell_coordinate(position, cell, side);
    const double parts = static_cast<double>(1u << refine);
    const double inside = (position / (1 << cell) + kBorderCells - c) * parts;
    part = static_cast<uint32_t>(std::clamp(std::floor(inside), 0.0, parts - 1));
    return c;
  };
  const uint32_t cx = place(mean[0], p.width, bits.x, s.px), cy = place(mean[1], p.height, bits.y, s.py);
  s.cell = spread_bits(cx) | spread_bits(cy) << 1;
  return true;
}

void dequantise(const RdParameters& p, const Symbols& s, float* mean, float* factor, float* color) {
  const Shape shape = shape_of(s);
  const Geometry g = geometry_of(s, shape);
  const Refinement bits = refinement_of(s, shape, g);
  const double side = std::ldexp(1.0, cell_bits(s.size_class));
  const auto place = [&](uint32_t cell, uint32_t part, int refine) {
    return static_cast<float>((static_cast<double>(cell) - kBorderCells + (part + 0.5) / (1u << refine)) * side);
  };
  mean[0] = place(gather_bits(s.cell), s.px, bits.x);
  mean[1] = place(gather_bits(s.cell >> 1), s.py, bits.y);
  factor[0] = static_cast<float>(g.l1);
  factor[1] = static_cast<float>(g.l2);
  factor[2] = static_cast<float>(g.l3);
  const double color_step = p.quantum / (class_size(s.size_class) * kSqrtPi);
  to_rgb({s.y * color_step, s.a * color_step, s.b * color_step}, color);
}

// A non-negative integer (plus one): its number of bits in unary, then the bits below the top one, the first modelled.
struct Magnitude {
  Bit exponent[32], high[32];

  template <typename Coder>
  uint32_t code(Coder& coder, uint32_t value = 0) {
    int e = 0;
    if constexpr (Coder::kDecodes) {
      while (e < 31 && coder.bit(exponent[e])) ++e;
    } else {
      while ((value + 1) >> (e + 1)) coder.bit(exponent[e++], 1);
      if (e < 31) coder.bit(exponent[e], 0);
    }
    uint32_t top = 1;
    const uint32_t shifted = value + 1;
    if (e >= 1) top = top << 1 | coder.bit(high[e], (shifted >> (e - 1)) & 1);
    if (e >= 2) top = top << (e - 1) | coder.raw(shifted & ((1u << (e - 1)) - 1), e - 1);
    return top - 1;
  }
};

// An integer: magnitude, then sign.
struct Signed {
  Magnitude magnitude;
  Bit sign;

  template <typename Coder>
  int code(Coder& coder, int value = 0) {
    const uint32_t size = magnitude.code(coder, static_cast<uint32_t>(std::abs(value)));
    if (size > static_cast<uint32_t>(kMaxColor)) throw std::runtime_error("a coded value is out of range");
    if (size == 0) return 0;
    return coder.bit(sign, value < 0) ? -static_cast<int>(size) : static_cast<int>(size);
  }
};

int level(int value) {  // of a magnitude, for contexts
  const int v = std::abs(value);
  return v == 0 ? 0 : v <= 2 ? 1 : v <= 6 ? 2 : 3;
}

// All adaptive models of a stream, and the one order in which a Gaussian's integers are coded. Few contexts: a small
// picture has a few hundred symbols for each to learn from. Contexts by size class, by the neighbour along the curve or by
// the sign of v were measured and cost more than they told (docs/design.md).
struct Model {
  Magnitude count, distance, luma_size;
  Bit luma_sign;
  Signed chroma_a[4], chroma_b[4];
  Signed aspect[8], shear[8];

  template <typename Coder>
  void gaussian(Coder& coder, const RdParameters& p, Symbols& s) {
    const uint32_t luma = luma_size.code(coder, static_cast<uint32_t>(std::abs(s.y)));
    if (luma > static_cast<uint32_t>(kMaxColor)) throw std::runtime_error("a colour is out of range");
    s.y = luma == 0 ? 0 : coder.bit(luma_sign, s.y < 0) ? -static_cast<int>(luma) : static_cast<int>(luma);
    if (!p.grey) {
      s.a = chroma_a[level(s.y)].code(coder, s.a);
      s.b = chroma_b[level(s.a)].code(coder, s.b);
    } else {
      s.a = s.b = 0;
    }
    if (s.y == 0 && s.a == 0 && s.b == 0) throw std::runtime_error("a Gaussian has no colour");
    const Shape shape = shape_of(s);
    s.u = coder.raw(s.u, shape.u_bits);
    s.v = aspect[shape.bucket].code(coder, s.v);
    s.r = p.upright ? 0 : shear[shape.bucket].code(coder, s.r);
    if (std::abs(s.v) > kMaxShape || std::abs(s.r) > kMaxShape || std::abs(s.v * shape.v_step) > kMaxAspect)
      throw std::runtime_error("a shape is out of range");
    const Refinement bits = refinement_of(s, shape, geometry_of(s, shape));
    s.px = coder.raw(s.px, bits.x);
    s.py = coder.raw(s.py, bits.y);
  }
};

// Low bits of a distance along the curve that are sent as they are: with `count` Gaussians scattered over the class's
// cells the mean distance is cells / count, and a quarter of it is where modelling stops to pay.
int raw_distance_bits(const RdParameters& p, int size_class, uint32_t count) {
  const int bits = cell_bits(size_class);
  const uint64_t cells = static_cast<uint64_t>(cells_along(p.width, bits)) * cells_along(p.height, bits);
  int result = 0;
  for (uint64_t mean = cells / std::max(count, 1u); mean >= 8; mean /= 2) ++result;
  return result;
}

// The Morton code of the next Gaussian of a class; 32 bits at most, or an error.
template <typename Coder>
uint32_t code_cell(Coder& coder, Model& model, int raw_bits, uint32_t previous, uint32_t cell = 0) {
  const uint32_t distance = cell - previous;
  const uint64_t high = model.distance.code(coder, distance >> raw_bits);
  const uint64_t next = previous + (high << raw_bits) + coder.raw(distance & ((1u << raw_bits) - 1), raw_bits);
  if (next > 0xFFFFFFFFull) throw std::runtime_error("a position is out of range");
  return static_cast<uint32_t>(next);
}

// A decoder's memory and time follow the bytes it is given: so many Gaussians may stand in a payload. Fitted ones take
// 20 bits and more.
uint64_t most_in(const RdParameters& p, size_t bytes) {
  const uint64_t pixels = static_cast<uint64_t>(p.width) * static_cast<uint64_t>(p.height);
  return std::min({pixels, kMaxGaussians, uint64_t{8} * bytes + 64});
}

// Appends Gaussians to `out` until the payload ends; with prefix = true, until the decoder has read past the data.
void decode_into(GaussianArrays& out, const RdParameters& p, RangeDecoder& coder, uint64_t most, bool prefix) {
  Model model;
  uint64_t total = 0;
  for (int c = kMaxClass; c >= kMinClass; --c) {
    const uint32_t count = model.count.code(coder);
    if (prefix && coder.overrun() > 0) return;
    total += count;
    if (!prefix && total > most) throw std::runtime_error("more Gaussians than the data can hold");
    Symbols s{};
    s.size_class = c;
    const int raw_bits = raw_distance_bits(p, c, count);
    for (uint32_t i = 0; i < count; ++i) {
      if (out.means.size() / 2 == most) return;  // a prefix alone gets here
      s.cell = code_cell(coder, model, raw_bits, s.cell);
      if (!in_grid(p, cell_bits(c), s.cell)) throw std::runtime_error("a position is out of range");
      model.gaussian(coder, p, s);
      if (prefix && coder.overrun() > 0) return;
      if (coder.overrun() > kMaxOverrun) throw std::runtime_error("the data end too early");
      float values[8];
      dequantise(p, s, values, values + 2, values + 5);
      out.means.insert(out.means.end(), values, values + 2);
      out.factors.insert(out.factors.end(), values + 2, values + 5);
      out.colors.insert(out.colors.end(), values + 5, values + 8);
    }
  }
  if (coder.overrun() > kMaxOverrun) throw std::runtime_error("the data end too early");
  if (!prefix && !coder.at_end()) throw std::runtime_error("there are bytes behind the last Gaussian");
}

}  // namespace

void rd_quantise(const RdParameters& p, const float* means, const float* factors, const float* colors, int n, float* out_means,
                 float* out_factors, float* out_colors) {
  for (int64_t i = 0; i < n; ++i) {
    Symbols s{};
    if (quantise(p, means + 2 * i, factors + 3 * i, colors + 3 * i, s)) {
      dequantise(p, s, out_means + 2 * i, out_factors + 3 * i, out_colors + 3 * i);
    } else {
      std::copy_n(means + 2 * i, 2, out_means + 2 * i);
      std::copy_n(factors + 3 * i, 3, out_factors + 3 * i);
      std::fill_n(out_colors + 3 * i, 3, 0.0f);
    }
  }
}

std::vector<uint8_t> rd_encode(const RdParameters& p, const float* means, const float* factors, const float* colors, int n) {
  std::vector<Symbols> all;
  all.reserve(n);
  for (int64_t i = 0; i < n; ++i) {
    Symbols s{};
    if (quantise(p, means + 2 * i, factors + 3 * i, colors + 3 * i, s)) all.push_back(s);
  }
  std::stable_sort(all.begin(), all.end(), [](const Symbols& a, const Symbols& b) {
    return a.size_class != b.size_class ? a.size_class > b.size_class : a.cell < b.cell;
  });
  if (all.size() > most_in(p, SIZE_MAX / 16)) throw std::invalid_argument("more Gaussians than pixels, or than 2^24");
  RangeEncoder coder;
  Model model;
  size_t at = 0;
  for (int c = kMaxClass; c >= kMinClass; --c) {
    size_t end = at;
    while (end < all.size() && all[end].size_class == c) ++end;
    const auto count = static_cast<uint32_t>(end - at);
    model.count.code(coder, count);
    const int raw_bits = raw_distance_bits(p, c, count);
    for (uint32_t previous = 0; at < end; ++at) {
      previous = code_cell(coder, model, raw_bits, previous, all[at].cell);
      model.gaussian(coder, p, all[at]);
    }
  }
  std::vector<uint8_t> bytes = coder.finish();
  while (all.size() > most_in(p, bytes.size())) bytes.push_back(0);  // thousands of equal ones; zeros change nothing
  return bytes;
}

GaussianArrays rd_decode(const RdParameters& p, const uint8_t* data, size_t size, bool prefix) {
  RangeDecoder coder(data, size);
  if (!coder.valid()) throw std::runtime_error("no encoder begins like this");
  GaussianArrays out;
  try {
    decode_into(out, p, coder, most_in(p, size), prefix);
  } catch (const std::runtime_error&) {
    if (!prefix || coder.overrun() == 0) throw;  // nonsense past the end of a prefix is no damage
  }
  return out;
}

}  // namespace sg
