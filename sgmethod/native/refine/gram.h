// Inner products of Gaussians of a coarse level, as pictures. A Gaussian with weights w in samples of its level has the
// picture U w, where U enlarges all the way down to pixels. The energy of its picture is w U^T U w, and it contributes
// U^T U w to the residual reduced to its level. Along an axis U^T U is a band of five diagonals, because the pictures
// of samples more than two apart do not overlap. Pixels outside the picture do not count.
//
// With the pixels' visibility V this is U^T V U, approximated by R U^T U R, where R is the square root of V's mean over
// each sample: visibility changes little from sample to sample.
#pragma once

#include <algorithm>
#include <vector>

#include "fit/fit_kernels.h"
#include "raster/planes.h"

namespace sg {

// The weights of one Gaussian in samples of its level, in a rectangle with a margin; and their product with U^T U.
class Patch {
 public:
  static constexpr int kMarginRows = 2, kMarginColumns = 8;
  static constexpr int kTaps = 5;

  // Sets the weights. spans: at least one.
  void draw(const Footprint& f, float floor, const std::vector<Span>& spans);

  int x() const { return x_; }  // place of the first column, including the margin
  int y() const { return y_; }
  int rows() const { return rows_; }
  int columns() const { return columns_; }
  const float* weights(int row) const { return weights_.data() + static_cast<size_t>(row) * columns_; }
  float* weights(int row) { return weights_.data() + static_cast<size_t>(row) * columns_; }
  const float* product(int row) const { return product_.data() + static_cast<size_t>(row) * columns_; }

 private:
  friend class Gram;
  int x_ = 0, y_ = 0, rows_ = 0, columns_ = 0;
  int begin_ = 0, end_ = 0;  // columns of the product: two beyond the weights. Others may belong to another task.
  std::vector<float> weights_, seen_, half_, product_;
};

class Gram {
 public:
  // grids: of the levels; visibility: of the pixels (core/constants.h), or null.
  Gram(const std::vector<Grid>& grids, const int16_t* visibility);

  // Sets the patch's product with a level's U^T U.
  void apply(int level, Patch& patch) const;
  // reduced += U^T U times a picture of a whole level, drawn by Rasterization::draw_coarse.
  void add(int level, Planes& picture, Planes& reduced) const;
  // Sums over the level: the patch's weights times the red, green and blue of a reduced residual, and times its own
  // product.
  static void project(const Patch& patch, int level, Planes& reduced, float* sums);
  // reduced += color [3] times the patch's product.
  static void add(const Patch& patch, int level, const float* color, Planes& reduced);

 private:
  static constexpr int kPad = 32;  // samples beyond both ends of an axis that a patch may touch
  // U^T U along an axis: at(tap, place) is the element of samples `place` and `place` + tap - 2.
  struct Band {
    explicit Band(int size) : stride(size + 2 * kPad), values(static_cast<size_t>(Patch::kTaps) * stride) {}
    float* at(int tap, int place) { return values.data() + index(tap, place); }
    const float* at(int tap, int place) const { return values.data() + index(tap, place); }
    size_t index(int tap, int place) const { return static_cast<size_t>(tap) * stride + place + kPad; }
    int stride;
    std::vector<float> values;
  };
  static std::vector<Band> bands(const std::vector<int>& sizes);
  // R of a level. row() returns its values from x on, which may lie kPad beyond the picture.
  struct Roots {
    int stride = 0, rows = 0;
    std::vector<float> values;
    const float* row(int x, int y) const {
      return values.data() + static_cast<size_t>(std::clamp(y, 0, rows - 1)) * stride + x + kPad;
    }
  };
  void set_roots(const std::vector<Grid>& grids, const int16_t* visibility);
  std::vector<Band> across_, down_;  // by level
  std::vector<Roots> roots_;  // by level; none without a visibility
};

}  // namespace sg
