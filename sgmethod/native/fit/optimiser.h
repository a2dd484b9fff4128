// What a step of the fit does to each Gaussian alone, apart from rendering: in the Gaussian's own frame, Adam
// (sgmethod/fitting/adam.py) or Gauss-Newton with momentum (sgmethod/fitting/newton.py).
#pragma once

namespace sg {

constexpr int kFrameValues = 8;  // d (2), S (3), colour (3): a step moves the mean by L d and the factor by L S

struct AdamSettings {
  AdamSettings(float mean_rate, float factor_rate, float color_rate, float beta1, float beta2, float min_scale);
  float rates[kFrameValues];  // relative change of each value in a step
  float beta1, beta2;
  float min_scale;  // l1, l3 at least this
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

struct NewtonSettings {
  float rate;         // times the step that a Gaussian without neighbours would need
  float most_frame;   // change of d and S in a step, at most
  float most_color;   // and of each colour
  float faint;        // length of a colour
  float beta;         // of the momentum
  float min_scale;    // l1, l3 at least this
};

// One step against the gradients of a mean squared error over `values` numbers, with the rate times `rate`. A Gaussian's
// own curvature is known: with c its colour, that of each value is 2 pi l1 l3 / values times |c|^2 / 2 for d, |c|^2 3 / 4
// or 1 / 4 for S, and 1 for the colour. |c| counts as at least `faint`: where a Gaussian that can hardly be seen is has no
// meaning. Neighbours that overlap add to the curvature. So a Gaussian whose gradient turns against its momentum eases. momentum [n, 8]; state [n, 2]: beta to the power of the
// Gaussian's steps so far, and how far it has eased.
void frame_newton(const NewtonSettings& settings, float rate, double values, int n, const MutableGaussians& p,
                  const ConstGaussians& grad, float* momentum, float* state);

// Keeps Gaussians where every file can say them: within the largest scale, slant and amplitude (constants.h), and means
// within reach sqrt(l1 l3) of the picture.
void keep_in_range(float reach, float width, float height, int n, const MutableGaussians& p);

}  // namespace sg
