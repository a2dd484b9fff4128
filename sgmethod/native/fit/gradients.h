// The residual of a drawn picture against a target, its squared error, and gradients by all parameters of the
// Gaussians.
#pragma once

#include <cstdint>

#include "core/constants.h"
#include "core/gaussians.h"
#include "fit/fit_kernels.h"
#include "raster/planes.h"
#include "raster/rasterization.h"

namespace sg {

// A target is [3, height, width], in which white is kTargetWhite; a visibility is [height, width] (core/constants.h).

// image [3, height, width] = residual: target minus picture, 1 being white.
void missing(const Rasterization& raster, const float* colors, const int16_t* target, float* image);
// The same at half the size, by means of four, of an odd side's last sample with itself. A part of the picture must
// begin with a whole tile.
void missing_halved(const Rasterization& raster, const float* colors, const int16_t* target, float* image);
// residual = target minus picture; reduced = the same, times the visibility if given, reduced to the coarse levels of
// raster.grids().
void draw_residual(const Rasterization& raster, const float* colors, const int16_t* target, const Strips& residual,
                   Planes& reduced, const int16_t* visibility = nullptr);

// Gradients of a loss whose gradient by the image is image_grad [3, height, width].
void backward(const Rasterization& raster, const float* colors, const float* image_grad, const MutableGaussians& out);
// out_colors = A^T V A colors, with A the weights of the Gaussians and V the visibility, or 1: the inner product of
// each Gaussian with the picture of all.
void gram(const Rasterization& raster, const float* colors, float* out_colors, const int16_t* visibility = nullptr);
// Mean squared error and its gradients: drawing, loss and backward at once, so that no picture is written to memory.
// With a visibility, errors are weighted by it and by `seen`, and coarse ones count once more. Throws
// std::invalid_argument for a part of a picture.
double squared_error(const Rasterization& raster, const float* colors, const int16_t* target,
                     const MutableGaussians& out, const int16_t* visibility = nullptr, const Seen& seen = kSeenByEye,
                     const Coarse& coarse = {});
// Mean squared error only.
double squared_error(const Rasterization& raster, const float* colors, const int16_t* target);

}  // namespace sg
