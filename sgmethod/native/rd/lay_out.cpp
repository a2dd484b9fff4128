#include "rd/lay_out.h"

#include <stdexcept>

namespace sg {
namespace {

constexpr size_t kFewestBits = 18;    // of a Gaussian; a file may have smaller ones, and then takes its time
constexpr size_t kMostRoom = 1 << 18;  // Gaussians for which memory is taken before they are counted

LaidOut laid_out(GaussianArrays&& g, const Canvas& canvas) {
  const int n = static_cast<int>(g.means.size() / 2);
  const int64_t most = most_pairs(n, canvas.width, canvas.height);
  return {std::make_unique<Rasterization>(g.means.data(), g.factors.data(), n, canvas, -1, most), std::move(g.colors)};
}

}  // namespace

LaidOut lay_out(const RdParameters& p, const uint8_t* data, size_t size, bool prefix, const Canvas& canvas) {
  const size_t room = 8 * size / kFewestBits + 1;
  if (room > kMostRoom) return laid_out(rd_decode(p, data, size, prefix), canvas);
  Arriving arriving(p, room);
  std::vector<float> colors(3 * room);
  bool crowded = false;
  StreamedGaussians streamed{static_cast<int>(room), {}, {}};
  streamed.bring = [&](const std::function<void(int)>& there) {
    try {
      arriving.decode(data, size, prefix, there);
    } catch (const std::overflow_error&) {
      crowded = true;
    }
  };
  streamed.values = [&](int first, int last, float* means, float* factors) {
    arriving.values(first, last, means, factors, &colors[3 * static_cast<size_t>(first)]);
  };
  auto raster = std::make_unique<Rasterization>(streamed, canvas, -1);
  if (crowded) return laid_out(rd_decode(p, data, size, prefix), canvas);
  colors.resize(3 * static_cast<size_t>(raster->gaussians()));
  return {std::move(raster), std::move(colors)};
}

}  // namespace sg
