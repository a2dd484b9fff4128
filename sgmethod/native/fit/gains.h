// What a round Gaussian would gain at each place of a residual: the search of matching pursuit
// (sgmethod/fitting/matching_pursuit.py).
#pragma once

#include <cstdint>
#include <vector>

namespace sg {

// A normalised Gaussian blur, and the factor on the squared residual that it leaves.
struct Blur {
  Blur(float sigma, float scale);
  float scale;
  std::vector<float> kernel;  // from its centre to one side, four sigma long
  int radius() const { return static_cast<int>(kernel.size()) - 1; }
};

// gain [height, width]: the largest of a blur's scale times the sum over planes of the blurred plane, squared; chosen:
// the number of that blur, the first of equals. planes [height, width] are mirrored at their edges, whose samples
// appear once. isa: one of core/isa.h.
void gains(const float* const (&planes)[3], int width, int height, const std::vector<Blur>& blurs, int isa, float* gain,
           uint8_t* chosen);

}  // namespace sg
