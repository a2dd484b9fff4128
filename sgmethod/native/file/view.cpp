// Views of a file: what sgmethod/view.py and sgmethod/decoder.py do, operation by operation.
#include <algorithm>
#include <cmath>
#include <memory>

#include "core/constants.h"
#include "core/errors.h"
#include "file/file.h"
#include "raster/rasterization.h"
#include "texture/texture.h"

namespace sg {
namespace {

constexpr double kPixelVariance = 1.0 / 12.0;  // of a box one pixel wide
constexpr double kMinViewScale = 1.0 / 64.0, kMaxViewScale = 64.0;
constexpr int64_t kFar = 1 << 16;  // output pixels
constexpr double kFloorV1 = 0.004086771438464067, kFloorV3 = 0.049787068367863944;  // exp(-cutoff)

void require(bool condition, const char* message) {
  if (!condition) refuse<std::invalid_argument>(message);
}

// The part of the picture that is drawn.
View area(const Header& header, View view) {
  require(view.scale >= kMinViewScale && view.scale <= kMaxViewScale, "the scale must lie in 1/64 .. 64");
  if (view.whole) view.x = view.y = 0, view.width = header.width, view.height = header.height;
  require(view.x >= 0 && view.y >= 0 && view.width >= 1 && view.height >= 1 && view.x < header.width &&
              view.y < header.height && view.width <= header.width - view.x && view.height <= header.height - view.y,
          "the region does not lie within the picture");
  return view;
}

// Of a weight exp(-sigma) - exp(-cutoff), in those of a whole Gaussian.
double variance(double cutoff) {
  const double floor = cutoff == kCutoffV1 ? kFloorV1 : kFloorV3;
  return (1 - floor * (1 + cutoff + cutoff * cutoff / 2)) / (1 - floor * (1 + cutoff));
}

// Gaussians in output pixels, without those that add nothing.
GaussianArrays resized(const GaussianArrays& g, const View& part, const double (&origin)[2], const double (&scale)[2],
                       double widening) {
  GaussianArrays out;
  const double corner[2] = {static_cast<double>(part.x), static_cast<double>(part.y)};
  double wide[2];
  for (int k = 0; k < 2; ++k) wide[k] = std::max(1 - scale[k] * scale[k], 0.0) * widening;
  for (size_t i = 0; i < g.means.size() / 2; ++i) {
    const float *mean = &g.means[2 * i], *factor = &g.factors[3 * i], *color = &g.colors[3 * i];
    if (!(factor[0] > 0 && factor[2] > 0)) continue;
    for (int k = 0; k < 2; ++k) out.means.push_back(static_cast<float>((mean[k] - corner[k]) * scale[k] + origin[k]));
    const double l1 = factor[0] * scale[0], l2 = factor[1] * scale[1], l3 = factor[2] * scale[1];
    const double n1 = std::sqrt(l1 * l1 + wide[0]), slant = l2 / n1;
    const double n2 = l1 * slant, n3 = std::sqrt(l3 * l3 + wide[1] + slant * slant * wide[0]);
    const double weight = (l1 * l3) / (n1 * n3);
    for (const double n : {n1, n2, n3}) out.factors.push_back(static_cast<float>(n));
    for (int k = 0; k < 3; ++k) out.colors.push_back(static_cast<float>(color[k] * weight));
  }
  return out;
}

// The largest whole number with 4^shift <= area.
int shift_of(double area) {
  int exponent;
  std::frexp(area, &exponent);
  return (exponent - 1) >> 1;
}

}  // namespace

Size size_of(const Header& header, const View& view) {
  const View part = area(header, view);
  const auto side = [&](int pixels) { return std::max(static_cast<int>(std::nearbyint(pixels * view.scale)), 1); };
  const Size size{side(part.width), side(part.height)};
  if (int64_t{size.width} * size.height > kMaxPixels) refuse<std::runtime_error>("the view has too many pixels");
  return size;
}

namespace {

void draw(const File& file, const View& view, GaussianArrays g, bool textured, const uint8_t* below, uint8_t* pixels) {
  const Header& header = file.header();
  const Size size = size_of(header, view);
  Canvas canvas{0, 0, size.width, size.height, header.cutoff, header.pyramid};
  const auto cells = [](int pixels) { return static_cast<int>(texture_cells(pixels)); };
  TextureGrid grid{cells(header.width), cells(header.height), kTextureCell, kTextureCell, 0, 0, 0};
  if (view.scale != 1 || !view.whole) {
    const View part = area(header, view);
    const double scale[2] = {static_cast<double>(size.width) / part.width, static_cast<double>(size.height) / part.height};
    if (header.pyramid) {  // where a part keeps its place
      canvas.x = static_cast<int>(static_cast<int64_t>(part.x * scale[0]) % kFar);
      canvas.y = static_cast<int>(static_cast<int64_t>(part.y * scale[1]) % kFar);
    }
    grid = {grid.columns, grid.rows, kTextureCell * scale[0], kTextureCell * scale[1], canvas.x - part.x * scale[0],
            canvas.y - part.y * scale[1], shift_of(2 * scale[0] * scale[1])};
    const double origin[2] = {static_cast<double>(canvas.x), static_cast<double>(canvas.y)};
    g = resized(g, part, origin, scale, kPixelVariance / variance(header.cutoff));
  }
  if (textured) canvas.texture = std::make_shared<Texture>(file.texture().data(), grid, header.version >= 5);
  const auto n = static_cast<int>(g.means.size() / 2);
  const Rasterization raster(g.means.data(), g.factors.data(), n, canvas, -1, most_pairs(n, size.width, size.height));
  float background[3];
  for (int k = 0; k < 3; ++k) background[k] = static_cast<float>(below[k] / 255.0);
  raster.render_bytes(g.colors.data(), background, pixels);
}

}  // namespace

void draw(const File& file, const View& view, uint8_t* pixels) {
  const bool textured = view.texture && !file.texture().empty();
  draw(file, view, file.gaussians(view.prefix), textured, file.header().background, pixels);
}

void draw_alpha(const File& file, const View& view, uint8_t* pixels) {
  const uint8_t below[3] = {file.alpha_background(), file.alpha_background(), file.alpha_background()};
  draw(file, view, file.alpha(), false, below, pixels);
}

}  // namespace sg
