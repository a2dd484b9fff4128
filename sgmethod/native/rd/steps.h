// The steps of a fit: Gaussians move down the gradient of their error and of the price of their bits. The fit moves
// real numbers, so the number of bits is a smooth estimate.
#pragma once

#include <cstdint>
#include <vector>

#include "core/constants.h"
#include "fit/optimiser.h"
#include "raster/rasterization.h"

namespace sg {

// What the steps minimise, and how: Descent in sgmethod/backend/protocol.py.
struct Descent {
  Canvas canvas;   // the frame
  float spacing;   // side of one of its pixels, in pixels of the whole picture: a power of two
  const int16_t* target;
  const int16_t* visibility;  // or null
  Seen seen;
  float coarse;  // weight of coarse errors
  float quantum, price;
  AdamSettings adam;
  float reach, width, height;  // of keep_in_range()
};

// Adds the gradient by factors and colours that Kernels.add_rate_gradient (sgmethod/backend/kernels.py) describes, for
// the Gaussians from first to before last. Means are neither read nor written.
void add_rate_gradient(float quantum, float weight, int first, int last, const ConstGaussians& p,
                       const MutableGaussians& grad);

// A step for each of the rates [steps], factors on all rates of the settings. Returns the mean squared error before
// each.
std::vector<double> rd_steps(const Descent& descent, const float* rates, int steps, int n, const MutableGaussians& p,
                             const Averages& averages);

}  // namespace sg
