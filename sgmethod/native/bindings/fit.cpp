#include <algorithm>
#include <utility>
#include <vector>

#include "bindings/arrays.h"
#include "bindings/lock.h"
#include "core/isa.h"
#include "core/thread_pool.h"
#include "fit/gains.h"
#include "fit/loss.h"
#include "fit/optimiser.h"
#include "fit/pixels.h"

using namespace nb::literals;

namespace {

// The loss, and a reference that keeps its target alive.
struct LossOfTarget {
  LossOfTarget(Image image, float lambda_g)
      : target(std::move(image)), loss(target.data(), side(target, 2), side(target, 1), lambda_g) {}
  Image target;
  sg::ReconstructionLoss loss;
};

double evaluate(LossOfTarget& held, Image image, ImageOut grad) {
  require_size(image, held.loss.width(), held.loss.height());
  require_size(grad, held.loss.width(), held.loss.height());
  const Unlocked unlocked;
  return held.loss(image.data(), grad.data());
}

void frame_adam(const sg::AdamSettings& settings, float rate, RowsOut<2> means, RowsOut<3> factors, RowsOut<3> colors,
                Rows<2> by_means, Rows<3> by_factors, Rows<3> by_colors, RowsOut<8> first, RowsOut<8> second,
                RowsOut<2> bias, std::optional<Visibility> visibility, float spacing, float coarse) {
  const int height = visibility ? side(*visibility, 0) : 0, width = visibility ? side(*visibility, 1) : 0;
  const sg::ErrorWeights weights{values_of(visibility, width, height), width, height, spacing, coarse};
  const int n = gaussians(means, factors, colors, by_means, by_factors, by_colors, first, second, bias);
  const Unlocked unlocked;
  sg::parallel_chunks(n, sg::kBlock, [&](int begin, int end, int) {
    sg::frame_adam(settings, weights, rate, begin, end, rows(means, factors, colors),
                   rows(by_means, by_factors, by_colors), {first.data(), second.data(), bias.data()});
  });
}

void keep_in_range(float reach, float width, float height, RowsOut<2> means, RowsOut<3> factors, RowsOut<3> colors) {
  const int n = gaussians(means, factors, colors);
  const Unlocked unlocked;
  sg::parallel_chunks(n, sg::kBlock, [&](int begin, int end, int) {
    sg::keep_in_range(reach, width, height, begin, end, rows(means, factors, colors));
  });
}

uint64_t squared_difference(Bytes a, Bytes b) {
  require(a.size() == b.size(), "as many values");
  const Unlocked unlocked;
  return sg::squared_difference(a.data(), b.data(), static_cast<int64_t>(a.size()));
}

double seen_difference(Pixels a, Pixels b, Visibility visibility, bool by_eye, double coarse) {
  const int height = side(a, 0), width = side(a, 1);
  require(side(b, 0) == height && side(b, 1) == width, "the pictures have different sizes");
  const int16_t* seen = values_of(visibility, width, height);
  const Unlocked unlocked;
  return sg::seen_difference(a.data(), b.data(), width, height, seen, by_eye ? sg::kSeenByEye : sg::kSeenAlike, coarse);
}

void to_amplitudes(ImageOut planes, Visibility visibility, std::optional<Numbers> root) {
  const int height = side(planes, 1), width = side(planes, 2);
  require(!root || root->size() == 9, "a matrix of 3 x 3");
  const int16_t* seen = values_of(visibility, width, height);
  const Unlocked unlocked;
  sg::to_amplitudes(planes.data(), width, height, seen, root ? root->data() : nullptr);
}

void gains(Plane red, Plane green, Plane blue, Numbers sigmas, Numbers scales, PlaneOut gain, MarksOut chosen,
           int isa) {
  const int height = side(red, 0), width = side(red, 1);
  const auto as_red = [&](const auto& plane) { return side(plane, 0) == height && side(plane, 1) == width; };
  require(as_red(green) && as_red(blue) && as_red(gain) && as_red(chosen), "the planes have different sizes");
  require(sigmas.size() == scales.size() && 0 < sigmas.size() && sigmas.size() < 256, "one scale for each blur");
  require(isa <= sg::best_isa(), "this processor lacks the instruction set");
  const auto fits = [](float sigma) { return sigma > 0 && sigma < 1000; };
  require(std::all_of(sigmas.data(), sigmas.data() + sigmas.size(), fits), "a blur is out of range");
  const Unlocked unlocked;
  std::vector<sg::Blur> blurs;
  for (size_t i = 0; i < sigmas.size(); ++i) blurs.emplace_back(sigmas.data()[i], scales.data()[i]);
  sg::gains({red.data(), green.data(), blue.data()}, width, height, blurs, isa < 0 ? sg::best_isa() : isa, gain.data(),
            chosen.data());
}

}  // namespace

void bind_fit(nb::module_& m) {
  nb::class_<LossOfTarget>(m, "ReconstructionLoss", "MSE + lambda_g L_g against a target.")
      .def(nb::init<Image, float>(), nb::call_guard<sg::WithMode>(), "target"_a, "lambda_g"_a)
      .def("__call__", &evaluate, "image"_a, "grad"_a.noconvert(),
           "Return the MSE alone; fill grad with the gradient of both by the image.");
  nb::class_<sg::AdamSettings>(m, "AdamSettings", "Settings of frame_adam(); rates are relative changes per step.")
      .def(nb::init<float, float, float, float, float, float, float, float>(), "mean_rate"_a, "factor_rate"_a,
           "color_rate"_a, "beta1"_a, "beta2"_a, "min_scale"_a, "newton_steps"_a, "values"_a);
  m.def("frame_adam", &frame_adam, "settings"_a, "rate"_a, "means"_a.noconvert(), "factors"_a.noconvert(),
        "colors"_a.noconvert(), "by_means"_a, "by_factors"_a, "by_colors"_a, "first"_a.noconvert(),
        "second"_a.noconvert(), "bias"_a.noconvert(), "visibility"_a.noconvert() = nb::none(), "spacing"_a = 1.0f,
        "coarse"_a = 0.0f, "Move Gaussians, and update first, second and bias: Kernels.step (backend/kernels.py).");
  m.def(
      "keep_in_range", &keep_in_range, "reach"_a, "width"_a, "height"_a, "means"_a.noconvert(), "factors"_a.noconvert(),
      "colors"_a.noconvert(),
      "Clamp scale, slant and amplitude to the limits of a fit, and means to within reach sqrt(l1 l3) of the picture.");
  m.def("squared_difference", &squared_difference, "a"_a, "b"_a, "Sum of squared differences.");
  m.def("seen_difference", &seen_difference, "a"_a, "b"_a, "visibility"_a, "by_eye"_a, "coarse"_a = 0.0,
        "VISIBLE times the squared difference of pictures, as the visibility counts it.");
  m.def("to_amplitudes", &to_amplitudes, "planes"_a.noconvert(), "visibility"_a, "root"_a.none(),
        "Scale an error's planes, in place, so that their squares are the error as it is seen.\n\n"
        "root [9]: square root of the weights of channels; None if all count alike.");
  m.def("gains", &gains, "red"_a, "green"_a, "blue"_a, "sigmas"_a, "scales"_a, "gain"_a.noconvert(),
        "chosen"_a.noconvert(), "isa"_a = -1,
        "Blur a residual's planes, mirrored at their edges, by each sigma [N].\n\n"
        "gain: the largest of a scale times the sum of the blurred planes' squares; chosen: whose it is.");
}
