#include "fit/optimiser.h"

#include <algorithm>
#include <cmath>

#include "core/constants.h"
#include "core/platform.h"
#include "core/simd.h"

namespace sg {
namespace {

constexpr int kTogether = 32;  // Gaussians whose values fit the level 1 cache

// Inverse of half the second derivative of the squared error by d, S and the colour, for an isolated Gaussian:
// integrals over pi l1 l3 of the squared derivative of w = exp(-sigma), as in rd/symbols.h. For d and S, to be divided
// by |colour|^2.
constexpr float kInverseCurvature[kAdamValues] = {2.0f, 2.0f, 4.0f / 3.0f, 4.0f, 4.0f / 3.0f, 1.0f, 1.0f, 1.0f};
constexpr int kOfShape = 5;  // number of values of d and S, which come first
constexpr double kPi = 3.14159265358979;
constexpr float kSquareVariance = kCoarseSide * kCoarseSide / 12.0f;  // along an axis

// Weights of the errors by which the curvature of up to kTogether Gaussians grows, at least 1. Where errors are hidden
// steps stay short, as they gain little there. Inlined into each clone: SSE code called from one of AVX2 costs a tenth
// of an encode. In loops of their own, as the visibility is seldom in a cache.
SG_INLINE void weigh(const ErrorWeights& errors, int count, const float* means, const float* factors, float* weights) {
  std::fill_n(weights, count, 1.0f);
  if (errors.visibility != nullptr) {
    const auto place = [&](float at, int size) {  // NaN is at 0
      at /= errors.spacing;
      return at >= 0 ? (at < static_cast<float>(size - 1) ? static_cast<int64_t>(at) : int64_t{size} - 1) : 0;
    };
    const int16_t* visible[kTogether];
    for (int j = 0; j < count; ++j) {
      const int64_t row = place(means[2 * j + 1], errors.height), column = place(means[2 * j], errors.width);
      __builtin_prefetch(visible[j] = errors.visibility + row * errors.width + column);
    }
    for (int j = 0; j < count; ++j) weights[j] = std::max(static_cast<float>(*visible[j]) / kVisible, 1.0f);
  }
  if (errors.coarse > 0) {
    // The share of the energy that means over squares keep.
    const auto kept = [](float l) { return l / std::sqrt(l * l + kSquareVariance); };
    for (int j = 0; j < count; ++j) weights[j] *= 1 + errors.coarse * kept(factors[3 * j]) * kept(factors[3 * j + 2]);
  }
}

// A step of up to kTogether Gaussians. The element-wise computation has its own loop, which the compiler vectorises.
SG_CLONES void step_together(const AdamSettings& s, const ErrorWeights& weights, int begin, int count,
                             const MutableGaussians& p, const ConstGaussians& grad, const Averages& averages) {
  float *const first = averages.first, *const second = averages.second, *const bias = averages.bias;
  float gradients[kTogether * kAdamValues], most[kTogether * kAdamValues], unbias[kTogether * 2];
  float curvature[kTogether];
  weigh(weights, count, p.means + 2 * begin, p.factors + 3 * begin, curvature);
  for (int j = 0; j < count; ++j) {
    const int i = begin + j;
    const float *l = p.factors + 3 * i, *color = p.colors + 3 * i;
    const float *gm = grad.means + 2 * i, *gl = grad.factors + 3 * i, *gc = grad.colors + 3 * i;
    // Gradients by d, S and the colour.
    const float g[kAdamValues] = {l[0] * gm[0] + l[1] * gm[1],
                                  l[2] * gm[1],
                                  l[0] * gl[0] + l[1] * gl[1],
                                  l[2] * gl[1],
                                  l[2] * gl[2],
                                  gc[0],
                                  gc[1],
                                  gc[2]};
    const float square = std::max(color[0] * color[0] + color[1] * color[1] + color[2] * color[2], kFaint);
    const float of_color = s.newton / (l[0] * l[2] * curvature[j]), of_shape = of_color / square;
    for (int k = 0; k < kAdamValues; ++k) {
      gradients[kAdamValues * j + k] = g[k];
      most[kAdamValues * j + k] = (k < kOfShape ? of_shape : of_color) * kInverseCurvature[k];
    }
    bias[2 * i] *= s.beta1;
    bias[2 * i + 1] *= s.beta2;
    unbias[2 * j] = 1 / (1 - bias[2 * i]);
    unbias[2 * j + 1] = 1 / (1 - bias[2 * i + 1]);
  }
  float* moves = gradients;  // overwrites the gradients
  for (int j = 0; j < count; ++j)
    for (int k = 0; k < kAdamValues; ++k) {
      const int at = kAdamValues * j + k;
      float &m1 = first[kAdamValues * begin + at], &m2 = second[kAdamValues * begin + at];
      const float g = gradients[at];
      m1 = s.beta1 * m1 + (1 - s.beta1) * g;
      m2 = s.beta2 * m2 + (1 - s.beta2) * g * g;
      const float adam = s.rates[k] / (std::sqrt(m2 * unbias[2 * j + 1]) + 1e-15f);
      moves[at] = -(adam < most[at] ? adam : most[at]) * m1 * unbias[2 * j];
    }
  for (int j = 0; j < count; ++j) {
    float *mean = p.means + 2 * (begin + j), *l = p.factors + 3 * (begin + j), *color = p.colors + 3 * (begin + j);
    const float* move = moves + kAdamValues * j;
    mean[0] += l[0] * move[0];
    mean[1] += l[1] * move[0] + l[2] * move[1];
    const float grow1 = std::exp(move[2]), grow3 = std::exp(move[4]);
    l[1] = l[1] * grow1 + l[2] * move[3];
    l[0] = std::max(l[0] * grow1, s.min_scale);
    l[2] = std::max(l[2] * grow3, s.min_scale);
    for (int k = 0; k < 3; ++k) color[k] += move[5 + k];
  }
}

}  // namespace

AdamSettings::AdamSettings(float mean_rate, float factor_rate, float color_rate, float beta1, float beta2,
                           float min_scale, float newton_steps, float values)
    : rates{mean_rate, mean_rate, factor_rate, factor_rate, factor_rate, color_rate, color_rate, color_rate},
      beta1(beta1), beta2(beta2), min_scale(min_scale), newton(static_cast<float>(newton_steps * values / (2 * kPi))) {}

void frame_adam(const AdamSettings& settings, const ErrorWeights& weights, float rate, int begin, int end,
                const MutableGaussians& p, const ConstGaussians& grad, const Averages& averages) {
  AdamSettings s = settings;
  for (float& r : s.rates) r *= rate;
  for (int i = begin; i < end; i += kTogether)
    step_together(s, weights, i, std::min(kTogether, end - i), p, grad, averages);
}

void keep_in_range(float reach, float width, float height, int begin, int end, const MutableGaussians& p) {
  constexpr auto kLargest = static_cast<float>(kMaxScale), kSlant = static_cast<float>(kMaxSlant);
  constexpr auto kAmplitude = static_cast<float>(kMaxAmplitude);
  for (int i = begin; i < end; ++i) {
    float *mean = p.means + 2 * i, *l = p.factors + 3 * i, *color = p.colors + 3 * i;
    l[0] = std::min(l[0], kLargest);
    l[2] = std::min(l[2], kLargest);
    l[1] = std::clamp(l[1], -kSlant * l[2], kSlant * l[2]);
    for (int k = 0; k < 3; ++k) color[k] = std::clamp(color[k], -kAmplitude, kAmplitude);
    const float margin = reach * std::sqrt(l[0] * l[2]);
    mean[0] = std::clamp(mean[0], -margin, width + margin);
    mean[1] = std::clamp(mean[1], -margin, height + margin);
  }
}

}  // namespace sg
