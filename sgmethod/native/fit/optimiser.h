// What a step of the fit does to each Gaussian alone, apart from rendering: Adam in the Gaussian's own frame
// (sgmethod/backend/protocol.py).
#pragma once

namespace sg {

constexpr int kAdamValues = 8;  // d (2), S (3), colour (3): a step moves the mean by L d and the factor by L S

struct AdamSettings {
  // newton_steps: of Gauss-Newton's steps, a step may be as long as so many; values: numbers of the picture, over which the
  // loss is the mean squared error.
  AdamSettings(float mean_rate, float factor_rate, float color_rate, float beta1, float beta2, float min_scale,
               float newton_steps, float values);
  float rates[kAdamValues];  // relative change of each value in a step
  float beta1, beta2;
  float min_scale;  // l1, l3 at least this
  float newton;     // a step may be so many times its gradient, divided by l1 l3 and by the curvature
};

// Rows of 2, 3, 3 values a Gaussian; grad_* likewise.
struct MutableGaussians {
  float *means, *factors, *colors;
};
struct ConstGaussians {
  const float *means, *factors, *colors;
};

// One step against the gradients, with all rates times `rate`. first, second [n, 8] are Adam's averages. bias [n, 2]
// holds beta1 and beta2 to the power of the Gaussian's steps so far: the share that the averages still have of the zeros
// they started from.
void frame_adam(const AdamSettings& settings, float rate, int n, const MutableGaussians& p, const ConstGaussians& grad,
                float* first, float* second, float* bias);

// Keeps Gaussians where every file can say them: within the largest scale, slant and amplitude (constants.h), and means
// within reach sqrt(l1 l3) of the picture.
void keep_in_range(float reach, float width, float height, int n, const MutableGaussians& p);

}  // namespace sg
