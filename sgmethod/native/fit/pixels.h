// Errors of pictures as they are seen, and of decoded ones in 8 bits.
#pragma once

#include <cstdint>

#include "core/constants.h"

namespace sg {

// Sum of squared differences of values. Exact, so in no particular order.
uint64_t squared_difference(const uint8_t* a, const uint8_t* b, int64_t count);

// The same of pictures [height][width][3] as they are seen, times kVisible. visibility: of each pixel; coarse: weight
// with which mean errors over squares of kCoarseSide pixels count once more.
double seen_difference(const uint8_t* a, const uint8_t* b, int width, int height, const int16_t* visibility,
                       const Seen& seen, double coarse);

// Scales an error's planes [3][height][width], in place, so that their squares are the error as it is seen. root [9]:
// square root of the weights of channels, or null if all count alike.
void to_amplitudes(float* planes, int width, int height, const int16_t* visibility, const float* root);

}  // namespace sg
