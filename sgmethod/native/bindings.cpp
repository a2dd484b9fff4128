// Translation between Python arrays and the kernels; no arithmetic here.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/tuple.h>

#include <algorithm>
#include <utility>

#include "raster/kernels.h"
#include "fit/loss.h"
#include "fit/optimiser.h"
#include "raster/rasterization.h"
#include "rd/codec.h"
#include "rd/refine.h"
#include "core/thread_pool.h"

namespace nb = nanobind;
using namespace nb::literals;

namespace {

// Inputs of another type or layout are converted; outputs are marked noconvert, or results would go to a copy.
template <int Columns>
using Rows = nb::ndarray<const float, nb::shape<-1, Columns>, nb::c_contig, nb::device::cpu>;
template <int Columns>
using RowsOut = nb::ndarray<float, nb::shape<-1, Columns>, nb::c_contig, nb::device::cpu>;
using Image = nb::ndarray<const float, nb::shape<3, -1, -1>, nb::c_contig, nb::device::cpu>;
using ImageOut = nb::ndarray<float, nb::shape<3, -1, -1>, nb::c_contig, nb::device::cpu>;
using BytesOut = nb::ndarray<uint8_t, nb::shape<-1, -1, 3>, nb::c_contig, nb::device::cpu>;

constexpr int kMaxSide = 1 << 20;  // the number of tiles stays within an int

void require(bool condition, const char* message) {
  if (!condition) throw nb::value_error(message);
}

template <typename Array>
void require_size(const Array& image, int width, int height) {
  require(image.shape(1) == static_cast<size_t>(height) && image.shape(2) == static_cast<size_t>(width), "image has another size");
}

template <size_t Columns>
nb::ndarray<nb::numpy, float, nb::shape<-1, Columns>> own(std::vector<float>&& values) {
  auto* kept = new std::vector<float>(std::move(values));
  nb::capsule owner(kept, [](void* p) noexcept { delete static_cast<std::vector<float>*>(p); });
  return nb::ndarray<nb::numpy, float, nb::shape<-1, Columns>>(kept->data(), {kept->size() / Columns, Columns}, owner);
}

sg::Rasterization* make(Rows<2> means, Rows<3> factors, int width, int height, float cutoff, int isa, int64_t max_pairs) {
  require(means.shape(0) == factors.shape(0), "means and factors differ in number");
  require(width > 0 && height > 0, "the image must have pixels");
  require(width <= kMaxSide && height <= kMaxSide, "the image is too large");
  require(cutoff > 0 && cutoff <= sg::kMaxCutoff, "the cutoff is out of range");
  const int n = static_cast<int>(means.shape(0));
  const int best = sg::best_isa();
  require(isa <= best, "this processor lacks the instruction set");
  nb::gil_scoped_release release;
  return new sg::Rasterization(means.data(), factors.data(), n, width, height, cutoff, isa < 0 ? best : isa, max_pairs);
}

// The loss and a share in the array it refers to.
struct LossOfTarget {
  LossOfTarget(Image image, float lambda_g)
      : target(std::move(image)),
        loss(target.data(), static_cast<int>(target.shape(2)), static_cast<int>(target.shape(1)), lambda_g) {}
  Image target;
  sg::ReconstructionLoss loss;
};

}  // namespace

NB_MODULE(_native, m) {
  m.doc() = "Compiled kernels; see sgmethod.render for their meaning.";
  m.attr("MAX_CUTOFF") = sg::kMaxCutoff;
  m.attr("TILE_WIDTH") = sg::kTileWidth;
  m.attr("TILE_HEIGHT") = sg::kTileHeight;
  m.def("best_isa", &sg::best_isa);
  m.def("thread_count", &sg::thread_count);
  m.def("set_thread_count", &sg::set_thread_count, "count"_a);

  nb::class_<sg::Rasterization>(m, "Rasterization")
      .def(nb::new_(&make), "means"_a, "factors"_a, "width"_a, "height"_a, "cutoff"_a = sg::kMaxCutoff,
           "isa"_a = -1, "max_pairs"_a = sg::kMaxPairs)
      .def("render",
           [](const sg::Rasterization& r, Rows<3> colors, ImageOut image) {
             require(colors.shape(0) == static_cast<size_t>(r.gaussians()), "one colour per Gaussian");
             require_size(image, r.width(), r.height());
             nb::gil_scoped_release release;
             r.render(colors.data(), image.data());
           },
           "colors"_a, "image"_a.noconvert())
      .def(
          "render_bytes",
          [](const sg::Rasterization& r, Rows<3> colors, BytesOut image, std::tuple<float, float, float> background) {
             require(colors.shape(0) == static_cast<size_t>(r.gaussians()), "one colour per Gaussian");
             require(image.shape(0) == static_cast<size_t>(r.height()) && image.shape(1) == static_cast<size_t>(r.width()),
                     "image has another size");
             const float below[3] = {std::get<0>(background), std::get<1>(background), std::get<2>(background)};
             nb::gil_scoped_release release;
             r.render_bytes(colors.data(), below, image.data());
           },
          "colors"_a, "image"_a.noconvert(), "background"_a = std::make_tuple(0.0f, 0.0f, 0.0f))
      .def("squared_error", [](const sg::Rasterization& r, Rows<3> colors, Image target, RowsOut<2> means, RowsOut<3> factors, RowsOut<3> out) {
        const auto n = static_cast<size_t>(r.gaussians());
        require(colors.shape(0) == n && means.shape(0) == n && factors.shape(0) == n && out.shape(0) == n, "one row per Gaussian");
        require_size(target, r.width(), r.height());
        nb::gil_scoped_release release;
        return r.squared_error(colors.data(), target.data(), {means.data(), factors.data(), out.data()});
      }, "colors"_a, "target"_a, "means"_a.noconvert(), "factors"_a.noconvert(), "out_colors"_a.noconvert())
      .def("backward", [](const sg::Rasterization& r, Rows<3> colors, Image grad, RowsOut<2> means, RowsOut<3> factors, RowsOut<3> out) {
        const auto n = static_cast<size_t>(r.gaussians());
        require(colors.shape(0) == n && means.shape(0) == n && factors.shape(0) == n && out.shape(0) == n, "one row per Gaussian");
        require_size(grad, r.width(), r.height());
        nb::gil_scoped_release release;
        r.backward(colors.data(), grad.data(), {means.data(), factors.data(), out.data()});
      }, "colors"_a, "grad"_a, "means"_a.noconvert(), "factors"_a.noconvert(), "out_colors"_a.noconvert());

  nb::class_<LossOfTarget>(m, "ReconstructionLoss")
      .def(nb::init<Image, float>(), "target"_a, "lambda_g"_a)
      .def("__call__", [](LossOfTarget& held, Image image, ImageOut grad) {
        sg::ReconstructionLoss& loss = held.loss;
        require_size(image, loss.width(), loss.height());
        require_size(grad, loss.width(), loss.height());
        sg::Loss value;
        {
          nb::gil_scoped_release release;
          value = loss(image.data(), grad.data());
        }
        return std::make_tuple(value.mse, value.geometry);
      }, "image"_a, "grad"_a.noconvert());

  nb::class_<sg::AdamSettings>(m, "AdamSettings")
      .def(
          "__init__",
          [](sg::AdamSettings* s, float mean_rate, float factor_rate, float color_rate, float beta1, float beta2, float min_scale) {
            new (s) sg::AdamSettings{{mean_rate, mean_rate, factor_rate, factor_rate, factor_rate, color_rate, color_rate, color_rate},
                                     beta1, beta2, min_scale};
          },
          "mean_rate"_a, "factor_rate"_a, "color_rate"_a, "beta1"_a, "beta2"_a, "min_scale"_a);
  m.def("frame_adam", [](const sg::AdamSettings& settings, float rate, RowsOut<2> means, RowsOut<3> factors, RowsOut<3> colors,
                         Rows<2> by_means, Rows<3> by_factors, Rows<3> by_colors, RowsOut<8> first, RowsOut<8> second, RowsOut<2> bias) {
    const auto n = means.shape(0);
    require(factors.shape(0) == n && colors.shape(0) == n && by_means.shape(0) == n && by_factors.shape(0) == n &&
                by_colors.shape(0) == n && first.shape(0) == n && second.shape(0) == n && bias.shape(0) == n, "one row per Gaussian");
    sg::AdamSettings scaled = settings;
    for (float& r : scaled.rates) r *= rate;
    nb::gil_scoped_release release;
    sg::frame_adam(scaled, static_cast<int>(n), {means.data(), factors.data(), colors.data()},
                   {by_means.data(), by_factors.data(), by_colors.data()}, first.data(), second.data(), bias.data());
  }, "settings"_a, "rate"_a, "means"_a.noconvert(), "factors"_a.noconvert(), "colors"_a.noconvert(), "by_means"_a, "by_factors"_a,
     "by_colors"_a, "first"_a.noconvert(), "second"_a.noconvert(), "bias"_a.noconvert());
  m.def("keep_near", [](float reach, float width, float height, RowsOut<2> means, Rows<3> factors) {
    require(means.shape(0) == factors.shape(0), "one row per Gaussian");
    nb::gil_scoped_release release;
    sg::keep_near(reach, width, height, static_cast<int>(means.shape(0)), means.data(), factors.data());
  }, "reach"_a, "width"_a, "height"_a, "means"_a.noconvert(), "factors"_a);
  m.def("rd_rate_gradient", [](float quantum, float weight, Rows<3> factors, Rows<3> colors, RowsOut<3> by_factors, RowsOut<3> by_colors) {
    const auto n = factors.shape(0);
    require(colors.shape(0) == n && by_factors.shape(0) == n && by_colors.shape(0) == n, "one row per Gaussian");
    nb::gil_scoped_release release;
    sg::rd_rate_gradient(quantum, weight, static_cast<int>(n), factors.data(), colors.data(), by_factors.data(), by_colors.data());
  }, "quantum"_a, "weight"_a, "factors"_a, "colors"_a, "by_factors"_a.noconvert(), "by_colors"_a.noconvert());

  nb::class_<sg::RdParameters>(m, "RdParameters")
      .def(
          "__init__",
          [](sg::RdParameters* p, int width, int height, double quantum, bool grey, bool upright) {
            require(width > 0 && height > 0 && quantum > 0, "parameters must be positive");
            require(width <= 65535 && height <= 65535, "a side is more than 65535 pixels");
            new (p) sg::RdParameters{width, height, quantum, grey, upright};
          },
          "width"_a, "height"_a, "quantum"_a, "grey"_a = false, "upright"_a = false);
  m.def("rd_quantise", [](const sg::RdParameters& p, Rows<2> means, Rows<3> factors, Rows<3> colors, RowsOut<2> out_means,
                          RowsOut<3> out_factors, RowsOut<3> out_colors) {
    const auto n = means.shape(0);
    require(factors.shape(0) == n && colors.shape(0) == n && out_means.shape(0) == n && out_factors.shape(0) == n &&
                out_colors.shape(0) == n, "one row per Gaussian");
    nb::gil_scoped_release release;
    sg::rd_quantise(p, means.data(), factors.data(), colors.data(), static_cast<int>(n), out_means.data(), out_factors.data(),
                    out_colors.data());
  }, "parameters"_a, "means"_a, "factors"_a, "colors"_a, "out_means"_a.noconvert(), "out_factors"_a.noconvert(),
     "out_colors"_a.noconvert());
  m.def("rd_encode", [](const sg::RdParameters& p, Rows<2> means, Rows<3> factors, Rows<3> colors) {
    const auto n = means.shape(0);
    require(factors.shape(0) == n && colors.shape(0) == n, "one row per Gaussian");
    const std::vector<uint8_t> bytes = sg::rd_encode(p, means.data(), factors.data(), colors.data(), static_cast<int>(n));
    return nb::bytes(bytes.data(), bytes.size());
  });
  m.def("rd_refine", [](const sg::RdParameters& p, Rows<2> means, Rows<3> factors, Rows<3> colors, Image target, float cutoff, double price,
                        int sweeps, double seconds, uint64_t max_bytes) {
    const auto n = means.shape(0);
    require(factors.shape(0) == n && colors.shape(0) == n, "one row per Gaussian");
    require_size(target, p.width, p.height);
    std::vector<uint8_t> bytes;
    {
      nb::gil_scoped_release release;
      bytes = sg::rd_refine(p, means.data(), factors.data(), colors.data(), static_cast<int>(n), target.data(),
                            {cutoff, price, sweeps, seconds, max_bytes});
    }
    return nb::bytes(bytes.data(), bytes.size());
  }, "parameters"_a, "means"_a, "factors"_a, "colors"_a, "target"_a, "cutoff"_a, "price"_a, "sweeps"_a, "seconds"_a, "max_bytes"_a);
  m.def("rd_decode", [](const sg::RdParameters& p, nb::bytes data, bool prefix, uint64_t max_gaussians) {
    sg::GaussianArrays decoded;
    {
      const auto* bytes = static_cast<const uint8_t*>(data.data());
      const size_t size = data.size();
      nb::gil_scoped_release release;
      decoded = sg::rd_decode(p, bytes, size, prefix, max_gaussians);
    }
    return std::make_tuple(own<2>(std::move(decoded.means)), own<3>(std::move(decoded.factors)), own<3>(std::move(decoded.colors)));
  }, "parameters"_a, "data"_a, "prefix"_a = false, "max_gaussians"_a = sg::kMaxGaussians);
}
