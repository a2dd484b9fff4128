#include "rd/steps.h"

#include <algorithm>
#include <cmath>
#include <vector>

#include "core/platform.h"
#include "core/scratch.h"
#include "core/simd.h"
#include "core/thread_pool.h"
#include "fit/gradients.h"

namespace sg {
namespace {

constexpr int kTogether = 32;  // Gaussians whose values fit the level 1 cache
constexpr float kInverseLn2 = 1.4426950409f;
constexpr float kTinySquare = 1e-12f;
constexpr float kUnitR = static_cast<float>(kRStep);

// kColorBasis in single precision.
constexpr float kBasis[3][3] = {{kColorBasis[0][0], kColorBasis[0][1], kColorBasis[0][2]},
                                {kColorBasis[1][0], kColorBasis[1][1], kColorBasis[1][2]},
                                {kColorBasis[2][0], kColorBasis[2][1], kColorBasis[2][2]}};

SG_INLINE float sign(float x) { return static_cast<float>(x > 0) - static_cast<float>(x < 0); }

// The gradients of up to kTogether Gaussians. Logarithms come first: a call in the other loop would empty its
// registers.
SG_CLONES void add_together(float quantum, float scale, int count, const float* l, const float* color, float* gl,
                            float* gc) {
  float logs[kTogether];
  for (int i = 0; i < count; ++i) logs[i] = std::log(l[3 * i] * (1 / l[3 * i + 2]));
  for (int i = 0; i < count; ++i, l += 3, color += 3, gl += 3, gc += 3) {
    const float inverse_step = static_cast<float>(kColorScale) / quantum * std::sqrt(l[0] * l[2]);
    float axis[3], square = kTinySquare;
    for (int a = 0; a < 3; ++a) {
      axis[a] = (kBasis[a][0] * color[0] + kBasis[a][1] * color[1] + kBasis[a][2] * color[2]) * inverse_step;
      square += axis[a] * axis[a];
    }
    const float m = std::sqrt(square);
    const float inverse_m = 1 / m, inverse_l3 = 1 / l[2];
    const float v = 0.5f * logs[i], r = l[1] * inverse_l3;
    // bits = sum log2(1 + |axis|) + log2(1 + |v| m) + log2(1 + |r| m / 2) + 3 log2(1 + m): colours, shape (v and r), and
    // size, x and y
    const float d_v = scale / (1 + std::abs(v) * m), d_r = scale / (1 + std::abs(r) * m / kUnitR) / kUnitR;
    const float d_m = d_v * std::abs(v) + d_r * std::abs(r) + 3 * scale / (1 + m);
    float d_log_size = 0;  // axis and m grow with sqrt(l1 l3)
    for (int a = 0; a < 3; ++a) {
      const float d_size = sign(axis[a]) * (scale / (1 + std::abs(axis[a])));
      const float d_axis = d_size + d_m * axis[a] * inverse_m;
      d_log_size += d_axis * axis[a];
      for (int k = 0; k < 3; ++k) gc[k] += d_axis * inverse_step * kBasis[a][k];
    }
    const float by_v = sign(v) * (d_v * m), by_r = sign(r) * (d_r * m);
    gl[0] += 0.5f * (d_log_size + by_v) / l[0];
    gl[1] += by_r * inverse_l3;
    gl[2] += (0.5f * (d_log_size - by_v) - by_r * r) * inverse_l3;
  }
}

}  // namespace

void add_rate_gradient(float quantum, float weight, int first, int last, const ConstGaussians& p,
                       const MutableGaussians& grad) {
  for (int i = first; i < last; i += kTogether)
    add_together(quantum, weight * kInverseLn2, std::min(kTogether, last - i), p.factors + 3 * i, p.colors + 3 * i,
                 grad.factors + 3 * i, grad.colors + 3 * i);
}

std::vector<double> rd_steps(const Descent& d, const float* rates, int steps, int n, const MutableGaussians& p,
                             const Averages& a) {
  std::vector<double> errors;
  const auto count = static_cast<size_t>(n);
  Scratch gradients(8 * count), placed(d.spacing == 1 ? 0 : 5 * count);
  const MutableGaussians by{gradients.get(), gradients.get() + 2 * count, gradients.get() + 5 * count};
  const float samples = 1 / d.spacing;
  const ErrorWeights weights{d.visibility, d.canvas.width, d.canvas.height, d.spacing, d.coarse};
  const Coarse coarse = Coarse::at(d.coarse, static_cast<int>(d.spacing));
  for (int step = 0; step < steps; ++step) {
    const float *means = p.means, *factors = p.factors;
    if (d.spacing != 1) {
      float* const at = placed.get();
      for (size_t i = 0; i < 2 * count; ++i) at[i] = means[i] * samples;
      for (size_t i = 0; i < 3 * count; ++i) at[2 * count + i] = factors[i] * samples;
      means = at, factors = at + 2 * count;
    }
    const Rasterization raster(means, factors, n, d.canvas, -1, kMaxPairs);
    errors.push_back(squared_error(raster, p.colors, d.target, by, d.visibility, d.seen, coarse));
    parallel_chunks(n, kBlock, [&](int first, int last, int) {
      for (int i = 2 * first; i < 2 * last; ++i) by.means[i] *= samples;
      for (int i = 3 * first; i < 3 * last; ++i) by.factors[i] *= samples;
      if (d.price > 0) add_rate_gradient(d.quantum, d.price, first, last, p, by);
      frame_adam(d.adam, weights, rates[step], first, last, p, by, a);
      keep_in_range(d.reach, d.width, d.height, first, last, p);
    });
  }
  return errors;
}

}  // namespace sg
