#include "fit/optimiser.h"

#include <algorithm>
#include <cmath>

#include "core/constants.h"
#include "core/thread_pool.h"

namespace sg {
namespace {

constexpr int kBlock = 512;  // Gaussians of a task
constexpr float kPi = 3.14159265f;
constexpr float kMostEased = 4.0f;
constexpr float kEasing = 0.1f, kRecovery = 0.05f;  // for a gradient straight against, and along, the momentum

// The gradients by d, S and the colour.
struct FrameGradient {
  FrameGradient(const float* l, const float* gm, const float* gl, const float* gc)
      : values{l[0] * gm[0] + l[1] * gm[1], l[2] * gm[1],  l[0] * gl[0] + l[1] * gl[1], l[2] * gl[1],
               l[2] * gl[2],                gc[0],         gc[1],                       gc[2]} {}
  float values[kFrameValues];
};

void move_by(const float* move, float min_scale, float* mean, float* l, float* color) {
  mean[0] += l[0] * move[0];
  mean[1] += l[1] * move[0] + l[2] * move[1];
  const float grow1 = std::exp(move[2]), grow3 = std::exp(move[4]);
  l[1] = l[1] * grow1 + l[2] * move[3];
  l[0] = std::max(l[0] * grow1, min_scale);
  l[2] = std::max(l[2] * grow3, min_scale);
  for (int k = 0; k < 3; ++k) color[k] += move[5 + k];
}

}  // namespace

AdamSettings::AdamSettings(float mean_rate, float factor_rate, float color_rate, float beta1, float beta2, float min_scale)
    : rates{mean_rate, mean_rate, factor_rate, factor_rate, factor_rate, color_rate, color_rate, color_rate},
      beta1(beta1), beta2(beta2), min_scale(min_scale) {}

void frame_adam(const AdamSettings& settings, float rate, int n, const MutableGaussians& p, const ConstGaussians& grad,
                float* first, float* second, float* bias) {
  AdamSettings s = settings;
  for (float& r : s.rates) r *= rate;
  parallel_each(n, kBlock, [&](int i) {
    float *mean = p.means + 2 * i, *l = p.factors + 3 * i, *color = p.colors + 3 * i;
    const FrameGradient by(l, grad.means + 2 * i, grad.factors + 3 * i, grad.colors + 3 * i);
    const float* g = by.values;
    bias[2 * i] *= s.beta1;
    bias[2 * i + 1] *= s.beta2;
    const float unbias1 = 1 / (1 - bias[2 * i]), unbias2 = 1 / (1 - bias[2 * i + 1]);
    float move[kFrameValues];
    for (int k = 0; k < kFrameValues; ++k) {
      float &m1 = first[kFrameValues * i + k], &m2 = second[kFrameValues * i + k];
      m1 = s.beta1 * m1 + (1 - s.beta1) * g[k];
      m2 = s.beta2 * m2 + (1 - s.beta2) * g[k] * g[k];
      move[k] = -s.rates[k] * m1 * unbias1 / (std::sqrt(m2 * unbias2) + 1e-15f);
    }
    move_by(move, s.min_scale, mean, l, color);
  });
}

void frame_newton(const NewtonSettings& s, float rate, double values, int n, const MutableGaussians& p,
                  const ConstGaussians& grad, float* momentum, float* state) {
  const auto scale = static_cast<float>(2 * kPi / values);
  parallel_each(n, kBlock, [&](int i) {
    float *mean = p.means + 2 * i, *l = p.factors + 3 * i, *color = p.colors + 3 * i;
    const FrameGradient by(l, grad.means + 2 * i, grad.factors + 3 * i, grad.colors + 3 * i);
    const float* g = by.values;
    float *m = momentum + kFrameValues * i, &zeros = state[2 * i], &eased = state[2 * i + 1];
    const float area = scale * l[0] * l[2];
    const float square = color[0] * color[0] + color[1] * color[1] + color[2] * color[2];
    const float energy = area * (square + s.faint * s.faint);
    const float of_frame = 1 / energy, of_color = 1 / area;
    const float inverse[kFrameValues] = {of_frame * 2,         of_frame * 2, of_frame * (1 / 0.75f), of_frame * 4,
                                         of_frame * (1 / 0.75f), of_color,     of_color,               of_color};
    float along = 0, steep = 1e-30f, fast = 1e-30f;
    for (int k = 0; k < kFrameValues; ++k) {
      along += g[k] * m[k] * inverse[k];
      steep += g[k] * g[k] * inverse[k];
      fast += m[k] * m[k] * inverse[k];
    }
    const float cosine = along / std::sqrt(steep * fast);
    eased = std::clamp(eased - cosine * (cosine < 0 ? kEasing : kRecovery), 0.0f, kMostEased);
    zeros *= s.beta;
    const float factor = s.rate * rate * std::exp(-eased) / (1 - zeros);
    float move[kFrameValues];
    for (int k = 0; k < kFrameValues; ++k) {
      const float most = k < 5 ? s.most_frame : s.most_color;
      m[k] = s.beta * m[k] + (1 - s.beta) * g[k];
      move[k] = std::clamp(-factor * m[k] * inverse[k], -most, most);
    }
    move_by(move, s.min_scale, mean, l, color);
  });
}

void keep_in_range(float reach, float width, float height, int n, const MutableGaussians& p) {
  constexpr auto kLargest = static_cast<float>(kMaxScale), kSlant = static_cast<float>(kMaxSlant);
  constexpr auto kAmplitude = static_cast<float>(kMaxAmplitude);
  parallel_each(n, kBlock, [&](int i) {
    float *mean = p.means + 2 * i, *l = p.factors + 3 * i, *color = p.colors + 3 * i;
    l[0] = std::min(l[0], kLargest);
    l[2] = std::min(l[2], kLargest);
    l[1] = std::clamp(l[1], -kSlant * l[2], kSlant * l[2]);
    for (int k = 0; k < 3; ++k) color[k] = std::clamp(color[k], -kAmplitude, kAmplitude);
    const float margin = reach * std::sqrt(l[0] * l[2]);
    mean[0] = std::clamp(mean[0], -margin, width + margin);
    mean[1] = std::clamp(mean[1], -margin, height + margin);
  });
}

}  // namespace sg
