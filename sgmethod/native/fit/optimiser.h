// The optimiser: Adam in each Gaussian's own frame (sgmethod/backend/protocol.py).
#pragma once

#include <cstdint>

#include "core/gaussians.h"

namespace sg {

constexpr int kBlock = 512;     // Gaussians of a task
constexpr int kAdamValues = 8;  // d (2), S (3), colour (3): a step moves the mean by L d and the factor by L S

struct AdamSettings {
  // newton_steps: longest step, in steps of Gauss-Newton; values: samples of the picture, over which the loss is a
  // mean.
  AdamSettings(float mean_rate, float factor_rate, float color_rate, float beta1, float beta2, float min_scale,
               float newton_steps, float values);
  float rates[kAdamValues];  // relative change of each value per step
  float beta1, beta2;
  float min_scale;  // least l1 and l3
  float newton;     // longest step, in multiples of the gradient divided by l1 l3 and by the curvature
};

// Weights of the errors that are minimised, by which the curvature grows.
struct ErrorWeights {
  const int16_t* visibility;  // [height, width], or null
  int width, height;
  float spacing;  // of the visibility, in pixels of the whole picture
  float coarse;   // weight with which coarse errors count once more
};

// first, second [n, 8]: Adam's averages; bias [n, 2]: beta1 and beta2 to the power of the Gaussian's steps so far,
// which is the weight of the initial zeros in the averages.
struct Averages {
  float *first, *second, *bias;
};

// One step down the gradients of the Gaussians from begin to before end, with all rates times `rate`.
void frame_adam(const AdamSettings& settings, const ErrorWeights& weights, float rate, int begin, int end,
                const MutableGaussians& p, const ConstGaussians& grad, const Averages& averages);

// Clamps the Gaussians from begin to before end to values that every file can represent: scale, slant and amplitude to
// the limits in constants.h, and means to within reach sqrt(l1 l3) of the picture.
void keep_in_range(float reach, float width, float height, int begin, int end, const MutableGaussians& p);

}  // namespace sg
