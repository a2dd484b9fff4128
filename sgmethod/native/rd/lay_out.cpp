#include "rd/lay_out.h"

#include <algorithm>
#include <stdexcept>
#include <utility>

namespace sg {
namespace {

constexpr size_t kMinBits = 18;    // of a Gaussian; a file may have smaller ones, and then takes its time
constexpr size_t kMaxRoom = 1 << 18;  // Gaussians for which memory is taken before they are counted

LaidOut laid_out(GaussianArrays&& g, const Canvas& canvas) {
  const int64_t max_pairs = max_pairs_of(g.count(), canvas.width, canvas.height);
  auto raster = std::make_unique<Rasterization>(g.means.data(), g.factors.data(), g.count(), canvas, -1, max_pairs);
  return {std::move(raster), std::move(g.colors)};
}

}  // namespace

LaidOut lay_out(const RdParameters& p, const uint8_t* data, size_t size, bool prefix,
                std::shared_ptr<const Texture> texture) {
  const Canvas canvas{0, 0, p.width, p.height, kCutoffV2, true, std::move(texture)};
  const size_t room = 8 * size / kMinBits + 1;
  if (room > kMaxRoom) return laid_out(rd_decode(p, data, size, prefix), canvas);
  StreamingDecoder arriving(p, room);
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
    const ConstGaussians values = arriving.values();
    std::copy(values.means + 2 * first, values.means + 2 * last, means);
    std::copy(values.factors + 3 * first, values.factors + 3 * last, factors);
  };
  auto raster = std::make_unique<Rasterization>(streamed, canvas);
  if (crowded) return laid_out(rd_decode(p, data, size, prefix), canvas);
  const float* first = arriving.values().colors;
  std::vector<float> colors(first, first + 3 * static_cast<size_t>(raster->gaussians()));
  return {std::move(raster), std::move(colors)};
}

}  // namespace sg
