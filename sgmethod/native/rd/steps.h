// The steps of a fit: Gaussians move down the gradient of their error and of the price of their bits.
#pragma once

#include <cstdint>

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
  float quantum, price;
  AdamSettings adam;
  float reach, width, height;  // of keep_in_range()
};

// The optimiser's averages [n, 8] and powers of beta [n, 2].
struct Averages {
  float *first, *second, *bias;
};

// A step for each of the rates [steps], factors on all rates of the settings.
void rd_steps(const Descent& descent, const float* rates, int steps, int n, const MutableGaussians& p,
              const Averages& averages);

}  // namespace sg
