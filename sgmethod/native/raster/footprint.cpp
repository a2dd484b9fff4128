#include "raster/footprint.h"

#include <limits>

#include "core/platform.h"

namespace sg {
namespace {

constexpr int kMaxSegment = 16;   // rows; the recurrence's relative error stays below 16^2 / 2 * 6e-8
constexpr double kMaxDecay = 80.0;  // exp(-80): a neighbouring row is far outside the ellipse by then

// The rows of a column segment. Where a lane has sigma <= kMaxCutoff somewhere in the segment, it has
// |z2| < sqrt(2 kMaxCutoff) + rows / l3 in the first row. There sigma must stay below kFar = 80 (columns.h), so
// rows / l3 may be 9.
int segment_rows(float l3) {
  return std::clamp(static_cast<int>(std::min(9.0f * l3, static_cast<float>(kMaxSegment))), 1, kMaxSegment);
}

// A subnormal scale is none, whether or not the processor makes it zero.
bool drawable(const float* mean, const float* factor) {
  constexpr float kLeast = std::numeric_limits<float>::min();
  return std::isfinite(mean[0]) && std::isfinite(mean[1]) && std::isfinite(factor[1]) && factor[0] >= kLeast &&
         factor[2] >= kLeast && std::isfinite(factor[0]) && std::isfinite(factor[2]) && std::isfinite(1.0f / factor[0]) &&
         std::isfinite(1.0f / (factor[2] * factor[2])) && std::isfinite(factor[1] / factor[0]);
}

// exp(-x) = exp(-x / 1024)^1024
SG_CLONES void exps_minus(const double* x, double* value, int count) {
  for (int i = 0; i < count; ++i) {
    double v = 1.0;
    for (int k = 9; k > 0; --k) v = 1.0 - v * (x[i] * (1.0 / 1024.0)) * (1.0 / k);
    for (int k = 0; k < 10; ++k) v *= v;
    value[i] = v;
  }
}

}  // namespace

float exp_minus(double x) {
  double value;
  exps_minus(&x, &value, 1);
  return static_cast<float>(value);
}

// exp(-inv_l3^2). In a segment it is multiplied up to 120 times, and its error with it: so it is computed in double
// precision.
void set_decays(Footprint* footprints, int count) {
  constexpr int kTogether = 64;
  double x[kTogether] = {}, value[kTogether];
  for (int first = 0; first < count; first += kTogether) {
    const int here = std::min(kTogether, count - first);
    for (int i = 0; i < here; ++i) {
      const Footprint& f = footprints[first + i];
      x[i] = f.segment == 0 ? 0.0 : std::min(static_cast<double>(f.inv_l3) * f.inv_l3, kMaxDecay);
    }
    exps_minus(x, value, here);
    for (int i = 0; i < here; ++i) footprints[first + i].decay = static_cast<float>(value[i]);
  }
}

Footprint::Footprint(const float* mean, const float* factor) {
  if (!drawable(mean, factor)) return;
  x = mean[0];
  y = mean[1];
  inv_l1 = 1.0f / factor[0];
  inv_l3 = 1.0f / factor[2];
  shear = factor[1] / factor[0];
  segment = segment_rows(factor[2]);
}

}  // namespace sg
