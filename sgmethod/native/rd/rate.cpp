#include "rd/rate.h"

#include <algorithm>
#include <cmath>

#include "core/constants.h"
#include "core/platform.h"
#include "core/simd.h"

namespace sg {
namespace {

constexpr int kTogether = 32;  // Gaussians whose values fit the level 1 cache
constexpr float kInverseLn2 = 1.4426950409f;
constexpr float kTinySquare = 1e-12f;
constexpr float kUnitR = static_cast<float>(kRStep);

// kColorBasis in single precision.
constexpr float kBasis[3][3] = {
    {static_cast<float>(kColorBasis[0][0]), static_cast<float>(kColorBasis[0][1]), static_cast<float>(kColorBasis[0][2])},
    {static_cast<float>(kColorBasis[1][0]), static_cast<float>(kColorBasis[1][1]), static_cast<float>(kColorBasis[1][2])},
    {static_cast<float>(kColorBasis[2][0]), static_cast<float>(kColorBasis[2][1]), static_cast<float>(kColorBasis[2][2])}};

SG_INLINE float inverse_color_step(const float* l, float quantum) {
  return static_cast<float>(kColorScale) / quantum * std::sqrt(l[0] * l[2]);
}
SG_INLINE float sign(float x) { return static_cast<float>(x > 0) - static_cast<float>(x < 0); }

// The gradients of up to kTogether Gaussians. Logarithms come first: a call in the other loop would empty its registers.
SG_CLONES void add_together(float quantum, float scale, int count, const float* l, const float* color, float* gl, float* gc) {
  float logs[kTogether];
  for (int i = 0; i < count; ++i) logs[i] = std::log(l[3 * i] * (1 / l[3 * i + 2]));
  for (int i = 0; i < count; ++i, l += 3, color += 3, gl += 3, gc += 3) {
    const float inverse_step = inverse_color_step(l, quantum);
    float axis[3], square = kTinySquare;
    for (int a = 0; a < 3; ++a) {
      axis[a] = (kBasis[a][0] * color[0] + kBasis[a][1] * color[1] + kBasis[a][2] * color[2]) * inverse_step;
      square += axis[a] * axis[a];
    }
    const float m = std::sqrt(square);
    const float inverse_m = 1 / m, inverse_l3 = 1 / l[2];
    const float v = 0.5f * logs[i], r = l[1] * inverse_l3;
    // bits = sum log2(1 + |axis|) + log2(1 + |v| m) + log2(1 + |r| m / 2) + 3 log2(1 + m)
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

void add_rate_gradient(float quantum, float weight, int first, int last, const float* factors, const float* colors,
                       float* grad_factors, float* grad_colors) {
  for (int i = first; i < last; i += kTogether)
    add_together(quantum, weight * kInverseLn2, std::min(kTogether, last - i), factors + 3 * i, colors + 3 * i,
                 grad_factors + 3 * i, grad_colors + 3 * i);
}

}  // namespace sg
