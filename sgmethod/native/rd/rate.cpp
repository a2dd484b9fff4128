#include "rd/rate.h"

#include <cmath>

#include "core/constants.h"

namespace sg {
namespace {

constexpr float kInverseLn2 = 1.4426950409f;
constexpr float kTinySquare = 1e-12f;
constexpr float kUnitR = static_cast<float>(kRStep);

// kColorBasis in single precision.
constexpr float kBasis[3][3] = {
    {static_cast<float>(kColorBasis[0][0]), static_cast<float>(kColorBasis[0][1]), static_cast<float>(kColorBasis[0][2])},
    {static_cast<float>(kColorBasis[1][0]), static_cast<float>(kColorBasis[1][1]), static_cast<float>(kColorBasis[1][2])},
    {static_cast<float>(kColorBasis[2][0]), static_cast<float>(kColorBasis[2][1]), static_cast<float>(kColorBasis[2][2])}};

float inverse_color_step(const float* l, float quantum) {
  return static_cast<float>(kColorScale) / quantum * std::sqrt(l[0] * l[2]);
}

}  // namespace

void add_rate_gradient(float quantum, float weight, int first, int last, const float* factors, const float* colors,
                       float* grad_factors, float* grad_colors) {
  for (int i = first; i < last; ++i) {
    const float *l = factors + 3 * i, *color = colors + 3 * i;
    float *gl = grad_factors + 3 * i, *gc = grad_colors + 3 * i;
    const float inverse_step = inverse_color_step(l, quantum), scale = weight * kInverseLn2;
    float axis[3], square = kTinySquare;
    for (int a = 0; a < 3; ++a) {
      axis[a] = (kBasis[a][0] * color[0] + kBasis[a][1] * color[1] + kBasis[a][2] * color[2]) * inverse_step;
      square += axis[a] * axis[a];
    }
    const float m = std::sqrt(square);
    const float inverse_m = 1 / m, inverse_l3 = 1 / l[2];
    const float v = 0.5f * std::log(l[0] * inverse_l3), r = l[1] * inverse_l3;
    // bits = sum log2(1 + |axis|) + log2(1 + |v| m) + log2(1 + |r| m / 2) + 3 log2(1 + m)
    const float d_v = scale / (1 + std::abs(v) * m), d_r = scale / (1 + std::abs(r) * m / kUnitR) / kUnitR;
    const float d_m = d_v * std::abs(v) + d_r * std::abs(r) + 3 * scale / (1 + m);
    float d_log_size = 0;  // axis and m grow with sqrt(l1 l3)
    for (int a = 0; a < 3; ++a) {
      const float d_size = std::copysign(scale / (1 + std::abs(axis[a])), axis[a]) * (axis[a] != 0);
      const float d_axis = d_size + d_m * axis[a] * inverse_m;
      d_log_size += d_axis * axis[a];
      for (int k = 0; k < 3; ++k) gc[k] += d_axis * inverse_step * kBasis[a][k];
    }
    const float by_v = std::copysign(d_v * m, v) * (v != 0), by_r = std::copysign(d_r * m, r) * (r != 0);
    gl[0] += 0.5f * (d_log_size + by_v) / l[0];
    gl[1] += by_r * inverse_l3;
    gl[2] += (0.5f * (d_log_size - by_v) - by_r * r) * inverse_l3;
  }
}

}  // namespace sg
