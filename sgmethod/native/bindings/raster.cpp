#include "raster/rasterization.h"

#include <nanobind/stl/tuple.h>

#include <memory>
#include <tuple>
#include <utility>

#include "bindings/arrays.h"
#include "bindings/lock.h"
#include "fit/gradients.h"
#include "texture/texture.h"

using namespace nb::literals;

namespace {

using Color = std::tuple<float, float, float>;

sg::Rasterization* rasterization(Rows<2> means, Rows<3> factors, int width, int height, float cutoff, int isa,
                                 int64_t max_pairs, bool pyramid, int x, int y, const sg::Texture* texture) {
  require(means.shape(0) == factors.shape(0), "means and factors differ in number");
  const int n = gaussians(means);
  const Unlocked unlocked;
  const sg::Canvas canvas{x, y, width, height, cutoff, pyramid, shared(texture)};
  return new sg::Rasterization(means.data(), factors.data(), n, canvas, isa, max_pairs);
}

auto unpack_texture(nb::bytes data, int width, int height) {
  require(width > 0 && height > 0, "the picture has no pixels");
  size_t used = 0;
  auto codes = sg::unpack_texture(static_cast<const uint8_t*>(data.data()), data.size(), width, height, used);
  auto array = own<nb::ndarray<nb::numpy, uint8_t, nb::ndim<3>>>(
      std::move(codes), {sg::kTextureOctaves, sg::texture_cells(height), sg::texture_cells(width)});
  return std::make_tuple(std::move(array), used);
}

sg::Texture* texture(Codes codes, double cell_x, double cell_y, double x, double y, int shift) {
  require(codes.shape(0) == sg::kTextureOctaves, "one plane of codes for each octave");
  const sg::WithMode mode;
  return new sg::Texture(codes.data(), {side(codes, 2), side(codes, 1), cell_x, cell_y, x, y, shift});
}

void require_colors(const sg::Rasterization& r, const Rows<3>& colors) {
  require(gaussians(colors) == r.gaussians(), "one colour per Gaussian");
}

sg::MutableGaussians gradients(const sg::Rasterization& r, const Rows<3>& colors, const RowsOut<2>& means,
                               const RowsOut<3>& factors, const RowsOut<3>& out_colors) {
  require(gaussians(colors, means, factors, out_colors) == r.gaussians(), "one row per Gaussian");
  return rows(means, factors, out_colors);
}

void render(const sg::Rasterization& r, Rows<3> colors, ImageOut image) {
  require_colors(r, colors);
  require_size(image, r.width(), r.height());
  const Unlocked unlocked;
  r.render(colors.data(), image.data());
}

void missing(const sg::Rasterization& r, Rows<3> colors, Target target, ImageOut image) {
  require_colors(r, colors);
  require_size(target, r.width(), r.height());
  require_size(image, r.width(), r.height());
  const Unlocked unlocked;
  sg::missing(r, colors.data(), target.data(), image.data());
}

void missing_halved(const sg::Rasterization& r, Rows<3> colors, Target target, ImageOut image) {
  require_colors(r, colors);
  require_size(target, r.width(), r.height());
  require_size(image, (r.width() + 1) / 2, (r.height() + 1) / 2);
  require(r.canvas().x % sg::kTileWidth == 0 && r.canvas().y % sg::kTileHeight == 0, "a part begins with a whole tile");
  const Unlocked unlocked;
  sg::missing_halved(r, colors.data(), target.data(), image.data());
}

void render_bytes(const sg::Rasterization& r, Rows<3> colors, BytesOut image, Color background) {
  require_colors(r, colors);
  require(side(image, 0) == r.height() && side(image, 1) == r.width(), "image has another size");
  const auto [red, green, blue] = background;
  const float below[3] = {red, green, blue};
  const Unlocked unlocked;
  r.render_bytes(colors.data(), below, image.data());
}

double squared_error(const sg::Rasterization& r, Rows<3> colors, Target target, RowsOut<2> means, RowsOut<3> factors,
                     RowsOut<3> out_colors, std::optional<Visibility> visibility, bool by_eye, float coarse,
                     int spacing) {
  const sg::MutableGaussians out = gradients(r, colors, means, factors, out_colors);
  require_size(target, r.width(), r.height());
  const int16_t* seen = values_of(visibility, r.width(), r.height());
  const Unlocked unlocked;
  return sg::squared_error(r, colors.data(), target.data(), out, seen, by_eye ? sg::kSeenByEye : sg::kSeenAlike,
                           sg::Coarse::at(coarse, spacing));
}

double error(const sg::Rasterization& r, Rows<3> colors, Target target) {
  require_colors(r, colors);
  require_size(target, r.width(), r.height());
  const Unlocked unlocked;
  return sg::squared_error(r, colors.data(), target.data());
}

void gram(const sg::Rasterization& r, Rows<3> colors, RowsOut<3> out_colors, std::optional<Visibility> visibility) {
  require(gaussians(colors, out_colors) == r.gaussians(), "one row per Gaussian");
  const int16_t* seen = values_of(visibility, r.width(), r.height());
  const Unlocked unlocked;
  sg::gram(r, colors.data(), out_colors.data(), seen);
}

void backward(const sg::Rasterization& r, Rows<3> colors, Image grad, RowsOut<2> means, RowsOut<3> factors,
              RowsOut<3> out_colors) {
  const sg::MutableGaussians out = gradients(r, colors, means, factors, out_colors);
  require_size(grad, r.width(), r.height());
  const Unlocked unlocked;
  sg::backward(r, colors.data(), grad.data(), out);
}

}  // namespace

void bind_raster(nb::module_& m) {
  m.def("max_pairs_of", &sg::max_pairs_of, "gaussians"_a, "width"_a, "height"_a,
        "Most pairs of Gaussian and tile that a picture may need; a file that needs more is hostile.");
  m.def("unpack_texture", &unpack_texture, "data"_a, "width"_a, "height"_a,
        "Decode a picture's texture codes [TEXTURE_OCTAVES, rows, columns]; also return the number of bytes read.\n\n"
        "Raises RuntimeError for data that no encoder writes.");
  nb::class_<sg::Texture>(
      m, "Texture",
      "Noise from a seed (sgmethod/native/texture/texture.h). Raises ValueError for invalid codes and cells.")
      .def(nb::new_(&texture), "codes"_a.noconvert(), "cell_x"_a, "cell_y"_a, "x"_a = 0.0, "y"_a = 0.0, "shift"_a = 0,
           "Take codes [TEXTURE_OCTAVES, rows, columns] below TEXTURE_STRENGTHS.\n\n"
           "cell_x, cell_y: sides of a cell, and x, y: the picture's corner, in output pixels; shift: octave o is "
           "drawn on level o + shift.");
  nb::class_<sg::Rasterization>(
      m, "Rasterization",
      "Gaussians' geometry on a pixel grid. Raises OverflowError for more than max_pairs pairs of Gaussian and tile.")
      .def(nb::new_(&rasterization), "means"_a, "factors"_a, "width"_a, "height"_a, "cutoff"_a = sg::kMaxCutoff,
           "isa"_a = -1, "max_pairs"_a = sg::kMaxPairs, "pyramid"_a = false, "x"_a = 0, "y"_a = 0,
           "texture"_a.none() = nb::none(),
           "Assign Gaussians to tiles.\n\n"
           "pyramid: wide Gaussians are drawn on coarser levels (sgmethod/native/raster/levels.h); x, y: the first "
           "pixel drawn, so that a part looks as in the whole picture; texture: drawn too, only with a pyramid.")
      .def_prop_ro("width", &sg::Rasterization::width)
      .def_prop_ro("height", &sg::Rasterization::height)
      .def("render", &render, "colors"_a, "image"_a.noconvert(), "Fill the image.")
      .def("missing", &missing, "colors"_a, "target"_a.noconvert(), "image"_a.noconvert(),
           "Fill the image, 1 being white: target, in which white is TARGET_WHITE, minus the picture.")
      .def("missing_halved", &missing_halved, "colors"_a, "target"_a.noconvert(), "image"_a.noconvert(),
           "Fill an image at half the size with means of four of missing(). A part must begin with a whole tile.")
      .def("render_bytes", &render_bytes, "colors"_a, "image"_a.noconvert(), "background"_a = Color(0.0f, 0.0f, 0.0f),
           "Fill the image: background plus Gaussians.")
      .def("squared_error", &squared_error, "colors"_a, "target"_a.noconvert(), "means"_a.noconvert(),
           "factors"_a.noconvert(), "out_colors"_a.noconvert(), "visibility"_a.noconvert() = nb::none(),
           "by_eye"_a = true, "coarse"_a = 0.0f, "spacing"_a = 1,
           "Mean squared error against a target; fills its gradients like backward().\n\n"
           "visibility: weights of the pixels' errors; by_eye: colours count as the eye sees them, else alike; coarse: "
           "weight with which mean errors over squares of 4 pixels of the whole picture count once more; spacing: side "
           "of a pixel, in those of the whole picture.")
      .def("error", &error, "colors"_a, "target"_a.noconvert(), "Mean squared error against a target.")
      .def("gram", &gram, "colors"_a, "out_colors"_a.noconvert(), "visibility"_a.noconvert() = nb::none(),
           "Fill out_colors: inner product of each Gaussian with the picture of all, weighted by visibility.")
      .def("backward", &backward, "colors"_a, "grad"_a, "means"_a.noconvert(), "factors"_a.noconvert(),
           "out_colors"_a.noconvert(), "Backpropagate a gradient by the image to means, factors and colours.");
}
