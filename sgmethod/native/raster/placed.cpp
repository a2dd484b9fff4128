#include "raster/placed.h"

#include "core/platform.h"

namespace sg {
namespace {

constexpr double kMaxDecay = 80.0;  // exp(-80): a neighbouring row is far outside the ellipse by then

// exp(-x) = exp(-x / 1024)^1024
SG_INLINE double exact_exp_minus(double x) {
  double v = 1.0;
  for (int k = 9; k > 0; --k) v = 1.0 - v * (x * (1.0 / 1024.0)) * (1.0 / k);
  for (int k = 0; k < 10; ++k) v *= v;
  return v;
}

SG_INLINE float decay(float inv_l3) {
  return static_cast<float>(exact_exp_minus(std::min(kMaxDecay, static_cast<double>(inv_l3) * inv_l3)));
}

}  // namespace

float exp_minus(double x) { return static_cast<float>(exact_exp_minus(x)); }
float decay_of(float inv_l3) { return decay(inv_l3); }

SG_CLONES void place(const float* means, const float* factors, int first, int count, bool pyramid, float reach,
                     Placed& p) {
  means += 2 * static_cast<int64_t>(first), factors += 3 * static_cast<int64_t>(first);
  constexpr int kMost = Placed::kMost;
  // The arrays are zero behind the last Gaussian, because whole vectors are computed.
  alignas(64) float mean_x[kMost] = {}, mean_y[kMost] = {}, l1[kMost] = {}, l2[kMost] = {}, l3[kMost] = {};
  for (int i = 0; i < count; ++i) {
    mean_x[i] = means[2 * i], mean_y[i] = means[2 * i + 1];
    l1[i] = factors[3 * i], l2[i] = factors[3 * i + 1], l3[i] = factors[3 * i + 2];
  }
  p.first = first, p.count = count;
  const int n = (count + 15) / 16 * 16;
  if (pyramid)
    for (int i = 0; i < n; ++i) {
      const float factor[3] = {l1[i], l2[i], l3[i]};
      p.level[i] = level_of(factor);
    }
  for (int i = 0; i < n; ++i) {
    const float mean[2] = {mean_x[i], mean_y[i]}, factor[3] = {l1[i], l2[i], l3[i]};
    const Levelled own(mean, factor, p.level[i]);
    mean_x[i] = own.mean[0], mean_y[i] = own.mean[1];
    l1[i] = own.factor[0], l2[i] = own.factor[1], l3[i] = own.factor[2];
    p.gain[i] = own.gain;
  }
  for (int i = 0; i < n; ++i) {
    const float mean[2] = {mean_x[i], mean_y[i]}, factor[3] = {l1[i], l2[i], l3[i]};
    const Footprint f(mean, factor);
    p.x[i] = f.x, p.y[i] = f.y, p.inv_l1[i] = f.inv_l1, p.inv_l3[i] = f.inv_l3, p.shear[i] = f.shear;
    p.segment[i] = f.segment;
    p.level[i] = f.segment == 0 ? 0 : p.level[i];
  }
  for (int i = 0; i < n; ++i) p.decay[i] = decay(p.inv_l3[i]);
  for (int i = 0; i < n; ++i) {
    const float factor[3] = {l1[i], l2[i], l3[i]};
    Footprint f;
    f.x = p.x[i], f.y = p.y[i], f.inv_l1 = p.inv_l1[i], f.shear = p.shear[i];
    const Ellipse e(f, factor, reach);
    p.l3[i] = e.l3, p.half_width[i] = e.half_width, p.summit[i] = e.summit, p.left[i] = e.left, p.right[i] = e.right;
    p.top[i] = e.top, p.bottom[i] = e.bottom, p.first_strip[i] = e.first_strip, p.last_strip[i] = e.last_strip;
  }
}

}  // namespace sg
