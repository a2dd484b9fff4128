#include "fit/optimiser.h"

#include <algorithm>
#include <cmath>

#include "rd/symbols.h"
#include "core/thread_pool.h"

namespace sg {
namespace {

constexpr int kBlock = 512;  // Gaussians a task
constexpr float kInverseLn2 = 1.4426950409f;
constexpr float kRStep = 2.0f;  // over m; that of v is 1
constexpr float kTinySquare = 1e-12f;

template <typename Each>
void for_each(int n, const Each& each) {
  parallel_chunks(n, kBlock, [&](int first, int last, int) {
    for (int i = first; i < last; ++i) each(i);
  });
}

float inverse_color_step(const float* l, float quantum) { return static_cast<float>(kColorScale) / quantum * std::sqrt(l[0] * l[2]); }

}  // namespace

void frame_adam(const AdamSettings& s, int n, const MutableGaussians& p, const ConstGaussians& grad, float* first, float* second,
                float* bias) {
  for_each(n, [&](int i) {
    float *mean = p.means + 2 * i, *l = p.factors + 3 * i, *color = p.colors + 3 * i;
    const float *gm = grad.means + 2 * i, *gl = grad.factors + 3 * i, *gc = grad.colors + 3 * i;
    const float g[kAdamValues] = {l[0] * gm[0] + l[1] * gm[1], l[2] * gm[1], l[0] * gl[0] + l[1] * gl[1], l[2] * gl[1],
                                  l[2] * gl[2], gc[0], gc[1], gc[2]};
    bias[2 * i] *= s.beta1;
    bias[2 * i + 1] *= s.beta2;
    const float unbias1 = 1 / (1 - bias[2 * i]), unbias2 = 1 / (1 - bias[2 * i + 1]);
    float move[kAdamValues];
    for (int k = 0; k < kAdamValues; ++k) {
      float &m1 = first[kAdamValues * i + k], &m2 = second[kAdamValues * i + k];
      m1 = s.beta1 * m1 + (1 - s.beta1) * g[k];
      m2 = s.beta2 * m2 + (1 - s.beta2) * g[k] * g[k];
      move[k] = -s.rates[k] * m1 * unbias1 / (std::sqrt(m2 * unbias2) + 1e-15f);
    }
    mean[0] += l[0] * move[0];
    mean[1] += l[1] * move[0] + l[2] * move[1];
    const float grow1 = std::exp(move[2]), grow3 = std::exp(move[4]);
    l[1] = l[1] * grow1 + l[2] * move[3];
    l[0] = std::max(l[0] * grow1, s.min_scale);
    l[2] = std::max(l[2] * grow3, s.min_scale);
    for (int k = 0; k < 3; ++k) color[k] += move[5 + k];
  });
}

void keep_near(float reach, float width, float height, int n, float* means, const float* factors) {
  for_each(n, [&](int i) {
    const float margin = reach * std::sqrt(factors[3 * i] * factors[3 * i + 2]);
    means[2 * i] = std::min(std::max(means[2 * i], -margin), width + margin);
    means[2 * i + 1] = std::min(std::max(means[2 * i + 1], -margin), height + margin);
  });
}

void rd_rate_gradient(float quantum, float weight, int n, const float* factors, const float* colors, float* grad_factors,
                      float* grad_colors) {
  // Rows: luma-like and two chroma-like axes, orthonormal, as in rd_symbols.cpp: equal steps are equal errors in RGB.
  static const float basis[3][3] = {{0.5773502692f, 0.5773502692f, 0.5773502692f},
                                    {0.7071067812f, 0, -0.7071067812f},
                                    {0.4082482905f, -0.8164965809f, 0.4082482905f}};
  for_each(n, [&](int i) {
    const float *l = factors + 3 * i, *color = colors + 3 * i;
    float *gl = grad_factors + 3 * i, *gc = grad_colors + 3 * i;
    const float inverse_step = inverse_color_step(l, quantum), scale = weight * kInverseLn2;
    float axis[3], square = kTinySquare;
    for (int a = 0; a < 3; ++a) {
      axis[a] = (basis[a][0] * color[0] + basis[a][1] * color[1] + basis[a][2] * color[2]) * inverse_step;
      square += axis[a] * axis[a];
    }
    const float m = std::sqrt(square);
    const float inverse_m = 1 / m, inverse_l3 = 1 / l[2];
    const float v = 0.5f * std::log(l[0] * inverse_l3), r = l[1] * inverse_l3;
    // bits = sum log2(1 + |axis|) + log2(1 + |v| m) + log2(1 + |r| m / 2) + 3 log2(1 + m)
    const float d_v = scale / (1 + std::abs(v) * m), d_r = scale / (1 + std::abs(r) * m / kRStep) / kRStep;
    const float d_m = d_v * std::abs(v) + d_r * std::abs(r) + 3 * scale / (1 + m);
    float d_log_size = 0;  // axis and m grow with sqrt(l1 l3)
    for (int a = 0; a < 3; ++a) {
      const float d_axis = std::copysign(scale / (1 + std::abs(axis[a])), axis[a]) * (axis[a] != 0) + d_m * axis[a] * inverse_m;
      d_log_size += d_axis * axis[a];
      for (int k = 0; k < 3; ++k) gc[k] += d_axis * inverse_step * basis[a][k];
    }
    const float by_v = std::copysign(d_v * m, v) * (v != 0), by_r = std::copysign(d_r * m, r) * (r != 0);
    gl[0] += 0.5f * (d_log_size + by_v) / l[0];
    gl[1] += by_r * inverse_l3;
    gl[2] += (0.5f * (d_log_size - by_v) - by_r * r) * inverse_l3;
  });
}

}  // namespace sg
