// A payload of profile rd on its way to a picture: Gaussians are laid over it while others are still being decoded.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <vector>

#include "raster/rasterization.h"
#include "rd/codec.h"

namespace sg {

struct LaidOut {
  std::unique_ptr<Rasterization> raster;
  std::vector<float> colors;  // [n, 3]
};

// The whole picture. Throws std::runtime_error as rd_decode() does, std::overflow_error for more pairs than it needs.
LaidOut lay_out(const RdParameters& parameters, const uint8_t* data, size_t size, bool prefix,
                std::shared_ptr<const Texture> texture);

}  // namespace sg
