// The residual of a drawn picture against a target, its squared error, and gradients by all numbers of the Gaussians.
#pragma once

#include <cstdint>

#include "core/constants.h"
#include "fit/fit_kernels.h"
#include "raster/planes.h"
#include "raster/rasterization.h"

namespace sg {

struct Gradients {
  float* means;    // [n, 2]
  float* factors;  // [n, 3]
  float* colors;   // [n, 3]
};

// A target is [3, height, width], its white kTargetWhite; a visibility is [height, width] (core/constants.h).

// image [3, height, width] = residual: target less picture, with 1 for white.
void missing(const Rasterization& raster, const float* colors, const int16_t* target, float* image);
// left = residual; reduced = residual, reduced to the coarse levels of raster.grids(). With a visibility, the residual is
// multiplied by it before it is reduced.
void leave(const Rasterization& raster, const float* colors, const int16_t* target, const Strips& left, Planes& reduced,
           const int16_t* visibility = nullptr);

// Gradients of a loss whose gradient by the image is image_grad [3, height, width].
void backward(const Rasterization& raster, const float* colors, const float* image_grad, const Gradients& out);
// out_colors = A^T A colors, with A the weights of the Gaussians: the product of each with the picture of all. With a
// visibility, that picture is multiplied by it first.
void gram(const Rasterization& raster, const float* colors, float* out_colors, const int16_t* visibility = nullptr);
// The mean squared error and its gradients: render, loss and backward at once, so that no picture goes through memory.
// With a visibility, errors are weighted by it and by `seen`. Throws std::invalid_argument for a part of a picture.
double squared_error(const Rasterization& raster, const float* colors, const int16_t* target, const Gradients& out,
                     const int16_t* visibility = nullptr, const Seen& seen = kSeenByEye);
// The mean squared error alone.
double squared_error(const Rasterization& raster, const float* colors, const int16_t* target);

}  // namespace sg
