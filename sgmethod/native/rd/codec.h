// Profile rd: Gaussians <-> bytes. The model of the stream is written once, for both directions (codec.cpp, models.h).
#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <vector>

#include "core/gaussians.h"

namespace sg {

struct RdParameters {
  // Throws std::invalid_argument for what no file can have.
  RdParameters(int width, int height, double quantum, bool grey, bool upright, bool is_short = false);
  int width, height;
  double quantum;   // about the root of the error energy of one step of any parameter; image in [0, 1]
  bool grey;        // no chroma in the stream
  bool upright;     // no shear in the stream
  bool is_short;    // the payload has one state for all symbols (entropy_coder.h)
};

constexpr uint64_t kMaxGaussians = 1 << 24;

// The payload's bytes. Gaussians whose colour rounds to nothing, and those with values that are not finite or scales
// that are not positive, are left out. Throws std::invalid_argument for more Gaussians than pixels or than 2^24.
std::vector<uint8_t> rd_encode(const RdParameters& parameters, const ConstGaussians& gaussians, int n);

// Throws std::runtime_error on data that no encoder writes. With prefix = true, data may be cut anywhere: the
// Gaussians up to there are returned, at most 3 for each byte and 64. Throws std::overflow_error for more than
// max_gaussians, before memory is taken for them.
GaussianArrays rd_decode(const RdParameters& parameters, const uint8_t* data, size_t size, bool prefix,
                         uint64_t max_gaussians = kMaxGaussians);

struct Decoded;

// The Gaussians of a payload while it is being decoded.
class StreamingDecoder {
 public:
  // room: capacity in Gaussians.
  StreamingDecoder(const RdParameters& parameters, size_t room);
  ~StreamingDecoder();

  // Decodes as rd_decode() does. arrived(n) is called again and again when the first n are there. Throws
  // std::overflow_error if the capacity may not suffice.
  void decode(const uint8_t* data, size_t size, bool prefix, const std::function<void(int)>& arrived);
  // Those that are there, which other threads may read.
  ConstGaussians values() const;

 private:
  const RdParameters p_;
  const size_t room_;
  const std::unique_ptr<Decoded> decoded_;
};

}  // namespace sg
