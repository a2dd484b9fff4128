// The reconstruction loss of the paper, L_train = MSE + lambda_g L_g, and its gradient by the image.
#pragma once

#include <cstdint>
#include <vector>

namespace sg {

// The loss against one target image [3, height, width] in [0, 1], which must outlive it.
class ReconstructionLoss {
 public:
  ReconstructionLoss(const float* target, int width, int height, float lambda_g);

  // Returns the MSE over pixels and channels. image, grad [3, height, width]; grad = d L_train / d image.
  double operator()(const float* image, float* grad);

  int width() const { return width_; }
  int height() const { return height_; }

 private:
  int64_t at(int channel, int row) const {  // start of a row in the padded planes
    return (static_cast<int64_t>(channel) * (height_ + 2) + row + 1) * stride_ + 1;
  }

  int width_, height_, stride_;
  float lambda_g_;
  const float* target_;  // [3, height, width]
  std::vector<float> weight_x_, weight_y_;  // |Gx|, |Gy| in padded planes, zero on the image's border
  std::vector<float> difference_, u_, v_;   // padded planes
};

}  // namespace sg
