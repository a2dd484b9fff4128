#include "fit/optimiser.h"

#include <algorithm>
#include <cmath>

#include "core/constants.h"
#include "core/thread_pool.h"

namespace sg {
namespace {

constexpr int kBlock = 512;  // Gaussians of a task

// Half the second derivative of the squared error by d, S and the colour, where a Gaussian lies alone: integrals over
// pi l1 l3 of the squared derivative of w = exp(-sigma), as in rd/symbols.h. Those of d and S count |colour|^2 times.
constexpr float kCurvature[kAdamValues] = {0.5f, 0.5f, 0.75f, 0.25f, 0.75f, 1.0f, 1.0f, 1.0f};
constexpr int kOfShape = 5;  // the first values, of d and S
constexpr float kFaint = 0.03f * 0.03f;  // |colour|^2 counts as at least this: a fainter Gaussian's shape would jump
constexpr double kPi = 3.14159265358979;

}  // namespace

AdamSettings::AdamSettings(float mean_rate, float factor_rate, float color_rate, float beta1, float beta2, float min_scale,
                           float newton_steps, float values)
    : rates{mean_rate, mean_rate, factor_rate, factor_rate, factor_rate, color_rate, color_rate, color_rate},
      beta1(beta1), beta2(beta2), min_scale(min_scale),
      newton(static_cast<float>(newton_steps * values / (2 * kPi))) {}

void frame_adam(const AdamSettings& settings, float rate, int n, const MutableGaussians& p, const ConstGaussians& grad,
                float* first, float* second, float* bias) {
  AdamSettings s = settings;
  for (float& r : s.rates) r *= rate;
  parallel_each(n, kBlock, [&](int i) {
    float *mean = p.means + 2 * i, *l = p.factors + 3 * i, *color = p.colors + 3 * i;
    const float *gm = grad.means + 2 * i, *gl = grad.factors + 3 * i, *gc = grad.colors + 3 * i;
    // By d, S and the colour.
    const float g[kAdamValues] = {l[0] * gm[0] + l[1] * gm[1], l[2] * gm[1], l[0] * gl[0] + l[1] * gl[1], l[2] * gl[1],
                                  l[2] * gl[2], gc[0], gc[1], gc[2]};
    bias[2 * i] *= s.beta1;
    bias[2 * i + 1] *= s.beta2;
    const float unbias1 = 1 / (1 - bias[2 * i]), unbias2 = 1 / (1 - bias[2 * i + 1]);
    const float square = std::max(color[0] * color[0] + color[1] * color[1] + color[2] * color[2], kFaint);
    const float newton = s.newton / (l[0] * l[2]);
    float move[kAdamValues];
    for (int k = 0; k < kAdamValues; ++k) {
      float &m1 = first[kAdamValues * i + k], &m2 = second[kAdamValues * i + k];
      m1 = s.beta1 * m1 + (1 - s.beta1) * g[k];
      m2 = s.beta2 * m2 + (1 - s.beta2) * g[k] * g[k];
      const float adam = s.rates[k] / (std::sqrt(m2 * unbias2) + 1e-15f);
      const float most = newton / (k < kOfShape ? kCurvature[k] * square : kCurvature[k]);
      move[k] = -std::min(adam, most) * m1 * unbias1;
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
