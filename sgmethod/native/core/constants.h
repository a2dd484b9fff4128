// Numbers of the format (docs/format.md) and of the kernels that more than one folder needs. Python reads them from the
// compiled module.
#pragma once

namespace sg {

constexpr int kMaxSide = 65535;  // pixels along a side of a picture: 16 bits in a file

// A Gaussian ends at the ellipse sigma = cutoff. Its weight is exp(-sigma) - exp(-cutoff), which is zero there. Each
// profile has its own cutoff.
constexpr float kMaxCutoff = 5.5f;  // the kernels' exponentials are sized for it
constexpr float kCutoffV2 = 3.0f;

constexpr double kMinScale = 0.3;  // pixels; l1 and l3 are at least this. Kernels use it in single precision.

// Limits during a fit. Files could represent more, but single precision could not: a Gaussian of the largest slant is
// 4,096 times as long as it is wide.
constexpr double kMaxScale = 8192.0;     // pixels; l1 and l3 are at most this
constexpr double kMaxSlant = 2048.0;     // |l2| / l3
constexpr double kMaxAmplitude = 32.0;   // of each colour, 1 being full white

constexpr float kFaint = 0.03f * 0.03f;  // least |colour|^2 in a step: without it, shapes of faint Gaussians would jump

// White in the target of a fit, which is in int16: 16 steps per level of 8 bits, so that means of four, and of sixteen,
// are whole numbers too. A large picture takes half the memory of float, and half the time to read.
constexpr int kTargetWhite = 16 * 255;

// An error e in red, green and blue counts (color |e|^2 + (luma e)^2) times the visibility of its pixel, an int16 in
// units of 1 / kVisible. For the eye an error in grey counts as its square, one in colour less.
constexpr int kVisible = 256;
struct Seen {
  float color, luma[3];
  // Replaces e [3] by half the gradient for a visibility of 1.
  void weigh(float* e) const {
    const float sum = e[0] * luma[0] + e[1] * luma[1] + e[2] * luma[2];
    for (int k = 0; k < 3; ++k) e[k] = color * e[k] + sum * luma[k];
  }
};
// Side of the squares, in pixels of the whole picture, whose mean errors may count once more for the eye.
constexpr int kCoarseSide = 4;
constexpr Seen kSeenByEye = {0.4f, {0.3484f, 0.8844f, 0.1072f}}, kSeenAlike = {1.0f, {0.0f, 0.0f, 0.0f}};

// A tile is the part of a picture drawn by one task: a block of rows in a strip of columns.
constexpr int kTileWidth = 16;
constexpr int kTileHeight = 64;

// Rows: the luma-like axis and two chroma-like axes of profile rd, a DCT over red, green and blue. Orthonormal, so
// equal steps are equal errors in RGB.
constexpr double kColorBasis[3][3] = {{0.57735026918962576, 0.57735026918962576, 0.57735026918962576},
                                      {0.70710678118654752, 0.0, -0.70710678118654752},
                                      {0.40824829046386302, -2 * 0.40824829046386302, 0.40824829046386302}};
constexpr double kColorScale = 1.5;  // a colour's step is quantum / (kColorScale s), s being the Gaussian's size

// Ratio of the steps of r = l2 / l3 and v = log sqrt(l1 / l3), at which both change the picture by the same energy.
constexpr double kRStep = 2.0;

}  // namespace sg
