#include "refine/outlook.h"

#include <algorithm>
#include <cmath>

#include "core/platform.h"

namespace sg {
namespace {

// The residual that a colour leaves, times derivatives of weights, summed over rows: as it is, times y, and times y^2.
SG_CLONES void sum_rows(const SpanSamples& s, const float* color, float square, float floor, int rows, float y,
                        float (&sums)[3][kTileWidth]) {
  constexpr float kUnit = 1.0f / kVisible;
  const float *weights = s.weights, *product = s.product, *e = s.residual;
  const int16_t* visibility = s.visibility;
  const float c0 = color[0], c1 = color[1], c2 = color[2];
  for (int row = 0; row < rows; ++row, y += 1.0f) {
    float weighted[kTileWidth];
    for (int i = 0; i < kTileWidth; ++i) {
      const float r = c0 * e[i] + c1 * e[i + s.color_stride] + c2 * e[i + 2 * s.color_stride] - square * product[i];
      weighted[i] = r * (weights[i] > 0.0f ? weights[i] + floor : 0.0f);
    }
    if (visibility != nullptr) {
      for (int i = 0; i < kTileWidth; ++i) weighted[i] *= static_cast<float>(visibility[i]) * kUnit;
      visibility += kTileWidth;
    }
    for (int i = 0; i < kTileWidth; ++i) {
      sums[0][i] += weighted[i];
      sums[1][i] += weighted[i] * y;
      sums[2][i] += weighted[i] * y * y;
    }
    weights += s.stride;
    product += s.stride;
    e += s.residual_stride;
  }
}

}  // namespace

void Outlook::add(const Footprint& f, const Span& span, const SpanSamples& samples) {
  float sums[3][kTileWidth] = {};
  const float y = static_cast<float>(span.first_row) + 0.5f - f.y;
  sum_rows(samples, color_, square_, floor_, span.last_row - span.first_row + 1, y, sums);
  for (int i = 0; i < kTileWidth; ++i) {
    const float x = static_cast<float>(span.strip * kTileWidth + i) + 0.5f - f.x, z1 = x * f.inv_l1;
    const float slanted = f.shear * x;  // z2 = (y - slanted) / l3
    const float z2 = (sums[1][i] - slanted * sums[0][i]) * f.inv_l3;
    const float z22 = (sums[2][i] - slanted * (2.0f * sums[1][i] - slanted * sums[0][i])) * f.inv_l3 * f.inv_l3;
    sums_[0][i] += z1 * sums[0][i];
    sums_[1][i] += z2;
    sums_[2][i] += z1 * z1 * sums[0][i];
    sums_[3][i] += z1 * z2;
    sums_[4][i] += z22;
  }
}

void Outlook::finish(const Symbols& s, const float* factor, double narrowed1, double narrowed3, double energy) {
  // Integrals over sigma < kCutoffV2 of the second terms for z1, z1^2 + z2^2, z1^2 - z2^2 and z1 z2, divided by |w|^2.
  constexpr double kMean = 0.597, kBoth = 1.279, kApart = 1.140, kSlant = 0.285;
  const double scales[] = {narrowed1, narrowed3, narrowed1 * narrowed1, narrowed1 * narrowed3, narrowed3 * narrowed3};
  double sums[kSteps] = {};
  for (int k = 0; k < kSteps; ++k) {
    for (const float sum : sums_[k]) sums[k] += sum;
    sums[k] *= 2.0 * scales[k];
  }
  const Steps steps(s);
  const Parts parts = parts_of(s, steps);
  const double side = power_of_two(cell_bits(s.size_class)), slant = factor[1] / factor[2];
  const double u = kClassWidth * power_of_two(-steps.u_bits()), v = steps.v(), r = steps.r();
  const double turn = -2.0 * slant * std::sinh(v);  // l2 stays in proportion to l3, so v turns a slanted Gaussian
  const double x1 = side * power_of_two(-parts.x_bits) / factor[0], x2 = -slant * x1;
  const double y2 = side * power_of_two(-parts.y_bits) / factor[2];
  slope_[kU] = u * (sums[2] + sums[4]);
  bend_[kU] = energy * kBoth * u * u;
  slope_[kV] = v * (sums[2] - sums[4]) + turn * sums[3];
  bend_[kV] = energy * (kApart * v * v + kSlant * turn * turn);
  slope_[kR] = r * sums[3];
  bend_[kR] = energy * kSlant * r * r;
  slope_[kX] = x1 * sums[0] + x2 * sums[1];
  bend_[kX] = energy * kMean * (x1 * x1 + x2 * x2);
  slope_[kY] = y2 * sums[1];
  bend_[kY] = energy * kMean * y2 * y2;
}

}  // namespace sg
