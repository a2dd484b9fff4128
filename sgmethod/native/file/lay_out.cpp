#include "file/lay_out.h"

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
  GaussianArrays g;
  g.means.reserve(2 * room), g.factors.reserve(3 * room), g.colors.reserve(3 * room);
  bool crowded = false;
  const auto bring = [&](const std::function<void(int)>& there) {
    try {
      rd_decode(p, data, size, prefix, room, g, [&](size_t n) { there(static_cast<int>(n)); });
    } catch (const std::overflow_error&) {
      crowded = true;
    }
  };
  const Arrivals arrivals{g.means.data(), g.factors.data(), static_cast<int>(room), bring};
  auto raster = std::make_unique<Rasterization>(arrivals, canvas, -1);
  if (crowded) return laid_out(rd_decode(p, data, size, prefix), canvas);
  return {std::move(raster), std::move(g.colors)};
}

}  // namespace sg
