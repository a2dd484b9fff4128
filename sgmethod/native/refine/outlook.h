// What one step of a Gaussian's integers may gain, estimated from one pass over its pixels.
//
// Let w be its weights, c their best colour, r the residual that this leaves, and dw the derivative of w for a step.
// With the best colour for each shape, the step changes the squared error by about
//     -2 c <r, dw> + |c|^2 (|dw|^2 - <w, dw>^2 / |w|^2).
// With z the place in units of the factor, dw is exp(-|z|^2 / 2) times z1 or z2 for the mean, z1^2 + z2^2 for u, z1^2 -
// z2^2 for v, and z1 z2 for r. So five sums over the pixels give the first term for every integer. The second is the
// energy |c|^2 |w|^2 times a constant.
#pragma once

#include "core/constants.h"
#include "raster/footprint.h"
#include "rd/symbols.h"

namespace sg {

// The samples of a span, from its first row on.
struct SpanSamples {
  const float *weights, *product;  // product: what the Gaussian, in a colour of 1, takes from the residual
  int64_t stride;  // from row to row
  const float* residual;
  int64_t residual_stride, color_stride;
  const int16_t* visibility;  // with kTileWidth values a row; or null
};

class Outlook {
 public:
  enum Step { kU, kV, kR, kX, kY, kSteps };

  // color: the best one, weighed as errors are seen; square: its product with the best one as it is.
  Outlook(const float* color, float square, float floor)
      : color_{color[0], color[1], color[2]}, square_(square), floor_(floor) {}

  // f: the Gaussian in samples of its level. Every span has to be added.
  void add(const Footprint& f, const Span& span, const SpanSamples& samples);
  // factor: in pixels; narrowed1, narrowed3: l1 and l3 divided by what they are on the Gaussian's level.
  void finish(const Symbols& s, const float* factor, double narrowed1, double narrowed3, double energy);

  // Change of the error by one step up (sign = 1) or down (-1): a lower estimate.
  double least_change(int step, int sign) const { return kCertain * bend_[step] - sign * slope_[step]; }

 private:
  static constexpr double kCertain = 0.5;  // part of the second term (docs/notebook/quantising.md)
  float color_[3], square_, floor_;
  float sums_[kSteps][kTileWidth] = {};  // of z1, z2, z1^2, z1 z2, z2^2
  double slope_[kSteps] = {}, bend_[kSteps] = {};
};

}  // namespace sg
