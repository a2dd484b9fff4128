// L_g = mean over pixels and channels of |Gx| (G'x - Gx)^2 + |Gy| (G'y - Gy)^2. The Sobel operator is linear, so
// G'x - Gx = Sobel_x(D) with D = image - target, and with u = |Gx| Sobel_x(D) the gradient by D is 2 Sobel_x^T(u).
// Sobel kernels are the usual ones (a ramp of slope 1 has gradient 8). Pixels without a whole 3x3 neighbourhood have
// weight 0, so the planes are padded by a frame of zeros and the transpose is the operator with the opposite sign.
#include "fit/loss.h"

#include <algorithm>
#include <cmath>

#include "core/platform.h"
#include "core/thread_pool.h"

namespace sg {
namespace {

constexpr int kBand = 32;   // rows per task
constexpr int kLanes = 16;  // partial sums, so that their order does not depend on the instruction set

// out = a - b; returns the sum of squares.
SG_CLONES double subtract(const float* a, const float* b, float* out, int count) {
  float partial[kLanes] = {};
  int i = 0;
  for (; i + kLanes <= count; i += kLanes)
    for (int k = 0; k < kLanes; ++k) {
      const float d = a[i + k] - b[i + k];
      out[i + k] = d;
      partial[k] += d * d;
    }
  double total = 0.0;
  for (float p : partial) total += static_cast<double>(p);
  for (; i < count; ++i) {
    out[i] = a[i] - b[i];
    total += static_cast<double>(out[i]) * static_cast<double>(out[i]);
  }
  return total;
}

// Sobel responses at `count` pixels of the row `p`; rows are `stride` apart.
SG_CLONES void sobel(const float* p, int64_t stride, float* gx, float* gy, int count) {
  const float *a = p - stride, *b = p + stride;
  for (int c = 0; c < count; ++c) {
    gx[c] = (a[c + 1] - a[c - 1]) + 2.0f * (p[c + 1] - p[c - 1]) + (b[c + 1] - b[c - 1]);
    gy[c] = (b[c - 1] - a[c - 1]) + 2.0f * (b[c] - a[c]) + (b[c + 1] - a[c + 1]);
  }
}

SG_CLONES void weigh(const float* wx, const float* wy, float* u, float* v, int count) {
  for (int c = 0; c < count; ++c) {
    u[c] *= wx[c];
    v[c] *= wy[c];
  }
}

// grad = mse_scale D + g_scale (Sobel_x^T(u) + Sobel_y^T(v)) along one row.
SG_CLONES void gradient_row(const float* d, const float* u, const float* v, int64_t stride, float* grad, int count,
                            float mse_scale, float g_scale) {
  const float *ua = u - stride, *ub = u + stride, *va = v - stride, *vb = v + stride;
  for (int c = 0; c < count; ++c) {
    const float x = (ua[c - 1] - ua[c + 1]) + 2.0f * (u[c - 1] - u[c + 1]) + (ub[c - 1] - ub[c + 1]);
    const float y = (va[c - 1] - vb[c - 1]) + 2.0f * (va[c] - vb[c]) + (va[c + 1] - vb[c + 1]);
    grad[c] = mse_scale * d[c] + g_scale * (x + y);
  }
}

}  // namespace

ReconstructionLoss::ReconstructionLoss(const float* target, int width, int height, float lambda_g)
    : width_(width), height_(height), stride_(width + 2), lambda_g_(lambda_g), target_(target) {
  const int64_t padded = 3 * static_cast<int64_t>(height + 2) * stride_;
  for (auto* plane : {&weight_x_, &weight_y_, &difference_, &u_, &v_}) plane->assign(padded, 0.0f);
  for (int k = 0; k < 3; ++k)
    for (int row = 0; row < height; ++row)
      std::copy_n(target + (static_cast<int64_t>(k) * height + row) * width, width, difference_.data() + at(k, row));
  for (int k = 0; k < 3; ++k)
    for (int row = 1; row < height - 1; ++row) {
      float *wx = weight_x_.data() + at(k, row) + 1, *wy = weight_y_.data() + at(k, row) + 1;
      if (width <= 2) continue;
      sobel(difference_.data() + at(k, row) + 1, stride_, wx, wy, width - 2);
      for (int c = 0; c < width - 2; ++c) {
        wx[c] = std::fabs(wx[c]);
        wy[c] = std::fabs(wy[c]);
      }
    }
}

double ReconstructionLoss::operator()(const float* image, float* grad) {
  const int bands = (height_ + kBand - 1) / kBand;
  const double values = 3.0 * static_cast<double>(width_) * height_;
  const float mse_scale = static_cast<float>(2.0 / values), g_scale = lambda_g_ * mse_scale;
  std::vector<double> squares(3 * bands);
  const auto for_rows = [&](const auto& body) {
    parallel_for(3 * bands, [&](int task) {
      const int channel = task / bands, first = (task % bands) * kBand;
      for (int row = first; row < std::min(height_, first + kBand); ++row)
        body(task, at(channel, row), (static_cast<int64_t>(channel) * height_ + row) * width_);
    });
  };
  float *const d = difference_.data(), *const u = u_.data(), *const v = v_.data();
  for_rows([&](int task, int64_t p, int64_t offset) {
    squares[task] += subtract(image + offset, target_ + offset, d + p, width_);
  });
  for_rows([&](int, int64_t p, int64_t) {
    sobel(d + p, stride_, u + p, v + p, width_);
    weigh(weight_x_.data() + p, weight_y_.data() + p, u + p, v + p, width_);
  });
  for_rows([&](int, int64_t p, int64_t offset) {
    gradient_row(d + p, u + p, v + p, stride_, grad + offset, width_, mse_scale, g_scale);
  });
  double mse = 0;
  for (double s : squares) mse += s / values;
  return mse;
}

}  // namespace sg
