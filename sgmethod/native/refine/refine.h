// Profile rd: coordinate descent on the integers of a coded picture.
#pragma once

#include <cstdint>
#include <vector>

#include "core/constants.h"
#include "rd/codec.h"

namespace sg {

struct RefineSettings {
  float cutoff;      // sigma at which a Gaussian ends
  double price;      // squared error, summed over the target, that one bit is worth
  int sweeps;        // over all Gaussians, at most
  double seconds;    // after which no further sweep begins, and one under way ends soon
  uint64_t max_bytes;  // of the payload; Gaussians that gain least for their bits go until it fits
  const int16_t* visibility = nullptr;  // [height, width] of the target: errors then count as they are seen (core/constants.h)
  Seen seen = kSeenByEye;
  int halvings = 0;  // of the picture, that make the target
};

// A side of a picture after halvings.
inline int halved(int side, int halvings) { return (side + (1 << halvings) - 1) >> halvings; }

// The payload of the Gaussians, rounded, with integers changed one Gaussian at a time wherever that lowers squared error
// plus price times bits. target [3, height, width]: what they should add up to, with kTargetWhite for white; the picture,
// or that halved a few times, where Gaussians are few and wide.
std::vector<uint8_t> rd_refine(const RdParameters& p, const float* means, const float* factors, const float* colors, int n,
                               const int16_t* target, const RefineSettings& settings);

}  // namespace sg
