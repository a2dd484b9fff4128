// Gaussians in arrays: means [n, 2] in pixels, factors [n, 3] = (l1, l2, l3) in pixels, colors [n, 3].
#pragma once

#include <vector>

namespace sg {

struct ConstGaussians {
  const float *means, *factors, *colors;
};

// Also gradients by these values.
struct MutableGaussians {
  float *means, *factors, *colors;
  operator ConstGaussians() const { return {means, factors, colors}; }
};

struct GaussianArrays {
  std::vector<float> means, factors, colors;
  int count() const { return static_cast<int>(means.size() / 2); }
  ConstGaussians rows() const { return {means.data(), factors.data(), colors.data()}; }
  MutableGaussians rows() { return {means.data(), factors.data(), colors.data()}; }
};

}  // namespace sg
