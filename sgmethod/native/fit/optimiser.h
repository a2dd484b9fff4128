// What a step of the fit does to each Gaussian alone, apart from rendering: Adam in the Gaussian's own frame
// (sgmethod/fit.py), and for profile rd the price of bits (sgmethod/quantise/rd.py).
#pragma once

namespace sg {

constexpr int kAdamValues = 8;  // d (2), S (3), colour (3)

struct AdamSettings {
  float rates[kAdamValues];  // relative change of each value in a step
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

// One step against the gradients. first, second [n, 8] are Adam's averages, bias [n, 2] what is left in them of the zeros that
// they started from: beta1 and beta2 to the power of the Gaussian's steps so far.
void frame_adam(const AdamSettings& settings, int n, const MutableGaussians& p, const ConstGaussians& grad, float* first, float* second,
                float* bias);

// Moves each mean that is further than reach sqrt(l1 l3) outside the picture back to there.
void keep_near(float reach, float width, float height, int n, float* means, const float* factors);

// Adds the gradient that sgmethod.quantise.rd.add_rate_gradient describes to grad_factors and grad_colors.
void rd_rate_gradient(float quantum, float weight, int n, const float* factors, const float* colors, float* grad_factors,
                      float* grad_colors);

}  // namespace sg
