// Profile rd: coordinate descent on the integers of a coded picture.
#pragma once

#include <cstdint>
#include <vector>

#include "core/constants.h"
#include "rd/codec.h"

namespace sg {

struct RefineSettings {
  double price;      // squared error, summed over the target, that one bit is worth
  int sweeps;        // limit on sweeps over all Gaussians
  double seconds;    // no sweep begins later, and a running one ends soon after
  uint64_t max_bytes;  // of the payload; Gaussians that gain least for their bits are dropped until it fits
  const int16_t* visibility = nullptr;  // [height, width] of the target: weights of errors (core/constants.h)
  Seen seen = kSeenByEye;
  int halvings = 0;  // number of times the picture was halved to give the target
};

// A side of a picture after halvings.
inline int halved(int side, int halvings) { return (side + (1 << halvings) - 1) >> halvings; }

// Encodes Gaussians, rounded, with integers changed one Gaussian at a time wherever that lowers squared error plus
// price times bits. target [3, height, width]: the sum that they should reach, kTargetWhite being white; smaller than
// the picture by `halvings` if Gaussians are few and wide.
std::vector<uint8_t> rd_refine(const RdParameters& p, const ConstGaussians& gaussians, int n, const int16_t* target,
                               const RefineSettings& settings);

}  // namespace sg
