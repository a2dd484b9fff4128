#include <nanobind/stl/tuple.h>
#include <nanobind/stl/unique_ptr.h>
#include <nanobind/stl/vector.h>

#include <tuple>
#include <utility>
#include <vector>

#include "bindings/arrays.h"
#include "bindings/lock.h"
#include "core/thread_pool.h"
#include "rd/codec.h"
#include "rd/lay_out.h"
#include "rd/steps.h"
#include "rd/symbols.h"
#include "refine/refine.h"

using namespace nb::literals;

namespace {

// The result of a function that runs without Python's lock.
template <typename Function>
auto without_lock(const Function& function) {
  const Unlocked unlocked;
  return function();
}

nb::bytes bytes_of(const std::vector<uint8_t>& bytes) { return nb::bytes(bytes.data(), bytes.size()); }

void rate_gradient(float quantum, float weight, Rows<3> factors, Rows<3> colors, RowsOut<3> by_factors,
                   RowsOut<3> by_colors) {
  const int n = gaussians(factors, colors, by_factors, by_colors);
  const Unlocked unlocked;
  sg::parallel_chunks(n, sg::kBlock, [&](int first, int last, int) {
    sg::add_rate_gradient(quantum, weight, first, last, {nullptr, factors.data(), colors.data()},
                          {nullptr, by_factors.data(), by_colors.data()});
  });
}

std::vector<double> steps(Target target, float cutoff, bool pyramid, float spacing, float quantum, float price,
                          const sg::AdamSettings& settings, Numbers rates, float reach, float width, float height,
                          RowsOut<2> means, RowsOut<3> factors, RowsOut<3> colors, RowsOut<8> first, RowsOut<8> second,
                          RowsOut<2> bias, std::optional<Visibility> visibility, bool by_eye, float coarse) {
  const int n = gaussians(means, factors, colors, first, second, bias);
  const int across = side(target, 2), down = side(target, 1);
  const sg::Descent descent{{0, 0, across, down, cutoff, pyramid},
                            spacing,
                            target.data(),
                            values_of(visibility, across, down),
                            by_eye ? sg::kSeenByEye : sg::kSeenAlike,
                            coarse,
                            quantum,
                            price,
                            settings,
                            reach,
                            width,
                            height};
  const Unlocked unlocked;
  return sg::rd_steps(descent, rates.data(), static_cast<int>(rates.size()), n, rows(means, factors, colors),
                      {first.data(), second.data(), bias.data()});
}

int64_t quantise(const sg::RdParameters& p, Rows<2> means, Rows<3> factors, Rows<3> colors, RowsOut<2> out_means,
                 RowsOut<3> out_factors, RowsOut<3> out_colors) {
  const int n = gaussians(means, factors, colors, out_means, out_factors, out_colors);
  const Unlocked unlocked;
  return sg::rd_quantise(p, rows(means, factors, colors), n, rows(out_means, out_factors, out_colors));
}

nb::bytes encode(const sg::RdParameters& p, Rows<2> means, Rows<3> factors, Rows<3> colors) {
  const int n = gaussians(means, factors, colors);
  return bytes_of(without_lock([&] { return sg::rd_encode(p, rows(means, factors, colors), n); }));
}

nb::bytes refine(const sg::RdParameters& p, Rows<2> means, Rows<3> factors, Rows<3> colors, Target target, double price,
                 int sweeps, double seconds, uint64_t max_bytes, std::optional<Visibility> visibility, bool by_eye,
                 int halvings) {
  const int n = gaussians(means, factors, colors);
  const int width = sg::halved(p.width, halvings), height = sg::halved(p.height, halvings);
  require_size(target, width, height);
  const sg::RefineSettings settings{price,
                                    sweeps,
                                    seconds,
                                    max_bytes,
                                    values_of(visibility, width, height),
                                    by_eye ? sg::kSeenByEye : sg::kSeenAlike,
                                    halvings};
  return bytes_of(
      without_lock([&] { return sg::rd_refine(p, rows(means, factors, colors), n, target.data(), settings); }));
}

auto decode(const sg::RdParameters& p, nb::bytes data, bool prefix, uint64_t max_gaussians) {
  const auto* bytes = static_cast<const uint8_t*>(data.data());
  sg::GaussianArrays decoded =
      without_lock([&, size = data.size()] { return sg::rd_decode(p, bytes, size, prefix, max_gaussians); });
  return std::make_tuple(own_rows<2>(std::move(decoded.means)), own_rows<3>(std::move(decoded.factors)),
                         own_rows<3>(std::move(decoded.colors)));
}

auto lay_out(const sg::RdParameters& p, nb::bytes data, bool prefix, const sg::Texture* texture) {
  const auto* bytes = static_cast<const uint8_t*>(data.data());
  sg::LaidOut laid_out =
      without_lock([&, size = data.size()] { return sg::lay_out(p, bytes, size, prefix, shared(texture)); });
  return std::make_tuple(std::move(laid_out.raster), own_rows<3>(std::move(laid_out.colors)));
}

}  // namespace

void bind_rd(nb::module_& m) {
  nb::class_<sg::RdParameters>(m, "RdParameters",
                               "Parameters of profile rd's stream that are known before its first Gaussian.")
      .def(nb::init<int, int, double, bool, bool, bool>(), "width"_a, "height"_a, "quantum"_a, "grey"_a = false,
           "upright"_a = false, "is_short"_a = false,
           "Describe a payload. is_short: whether all symbols share one state, as in a short file.");
  m.def("rd_clipped_values", &sg::clipped_values,
        "Number of values clamped to the range of their integers in this process, while Gaussians were quantised.");
  m.def("rd_rate_gradient", &rate_gradient, "quantum"_a, "weight"_a, "factors"_a, "colors"_a,
        "by_factors"_a.noconvert(), "by_colors"_a.noconvert(),
        "Add a gradient to by_factors and by_colors: Kernels.add_rate_gradient (sgmethod/backend/kernels.py).");
  m.def("rd_steps", &steps, "target"_a.noconvert(), "cutoff"_a, "pyramid"_a, "spacing"_a, "quantum"_a, "price"_a,
        "settings"_a, "rates"_a, "reach"_a, "width"_a, "height"_a, "means"_a.noconvert(), "factors"_a.noconvert(),
        "colors"_a.noconvert(), "first"_a.noconvert(), "second"_a.noconvert(), "bias"_a.noconvert(),
        "visibility"_a.noconvert() = nb::none(), "by_eye"_a = true, "coarse"_a = 0.0f,
        "Take a step for each of the rates: Backend.steps (sgmethod/backend/protocol.py).");
  m.def("rd_quantise", &quantise, "parameters"_a, "means"_a, "factors"_a, "colors"_a, "out_means"_a.noconvert(),
        "out_factors"_a.noconvert(), "out_colors"_a.noconvert(),
        "Fill out_* with Gaussians as a decoder would see them, with colour 0 if one rounds to nothing.\n\n"
        "Returns the number of values clamped to the range of their integers.");
  m.def("rd_encode", &encode, "parameters"_a, "means"_a, "factors"_a, "colors"_a);
  m.def(
      "rd_refine", &refine, "parameters"_a, "means"_a, "factors"_a, "colors"_a, "target"_a.noconvert(), "price"_a,
      "sweeps"_a, "seconds"_a, "max_bytes"_a, "visibility"_a.noconvert() = nb::none(), "by_eye"_a = true,
      "halvings"_a = 0,
      "Encode Gaussians, with their integers refined one Gaussian at a time (sgmethod/native/refine/refine.h).\n\n"
      "visibility, by_eye: see squared_error(); halvings: number of times the picture was halved to give the target.");
  m.def("rd_lay_out", &lay_out, "parameters"_a, "data"_a, "prefix"_a, "texture"_a.none() = nb::none(),
        "Decode a payload to a Rasterization of the whole picture and the colours; the two overlap in time.\n\n"
        "Raises the errors of rd_decode() and Rasterization, with max_pairs_of() as max_pairs.");
  m.def("rd_decode", &decode, "parameters"_a, "data"_a, "prefix"_a = false, "max_gaussians"_a = sg::kMaxGaussians,
        "Decode a payload to (means, factors, colors). prefix: data may be cut anywhere.\n\n"
        "Raises RuntimeError on data that no encoder writes, OverflowError for more than max_gaussians.");
}
