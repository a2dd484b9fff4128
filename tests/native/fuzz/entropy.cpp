// Fuzz target (libFuzzer): the entropy decoder of profile rd, and the drawing of what it gives. Whatever the bytes are,
// they decode or are refused, and every instruction set draws the same.
#include <cstdint>
#include <cstdlib>
#include <stdexcept>
#include <vector>

#include "core/constants.h"
#include "core/isa.h"
#include "core/thread_pool.h"
#include "raster/rasterization.h"
#include "rd/codec.h"

namespace {

constexpr size_t kHeader = 7;  // width, height, quantum, flags
constexpr int64_t kMaxPixels = 1 << 15;
constexpr uint64_t kMostGaussians = 1 << 14;

std::vector<uint8_t> picture(const sg::RdParameters& p, const sg::GaussianArrays& g, int isa, int64_t max_pairs) {
  const int n = static_cast<int>(g.means.size() / 2);
  const sg::Rasterization raster(g.means.data(), g.factors.data(), n, {0, 0, p.width, p.height, sg::kCutoffV3, false}, isa, max_pairs);
  std::vector<uint8_t> pixels(3 * static_cast<size_t>(p.width) * p.height);
  const float background[3] = {0.0f, 0.5f, 1.0f};
  raster.render_bytes(g.colors.data(), background, pixels.data());
  return pixels;
}

void draw(const sg::RdParameters& p, const sg::GaussianArrays& g) {
  if (int64_t{p.width} * p.height > kMaxPixels) return;
  const int64_t tiles = ((p.width + 15) / 16) * ((p.height + 63) / 64);  // and so many pairs as decoding allows
  const int64_t max_pairs = 16 * static_cast<int64_t>(g.means.size() / 2) + 256 * tiles;
  try {
    const std::vector<uint8_t> plain = picture(p, g, sg::kBaseline, max_pairs);
    for (int isa = sg::kAvx2; isa <= sg::best_isa(); ++isa)
      if (picture(p, g, isa, max_pairs) != plain) std::abort();
  } catch (const std::overflow_error&) {
  }
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  if (size < kHeader) return 0;
  sg::set_thread_count(1);
  const int flags = data[6];
  const double quantum = (256 + data[5]) / 4096.0 * (1 << data[4] % 16) / 64.0;  // from 2^-10 to 64
  try {
    const sg::RdParameters p(data[0] << 8 | data[1], data[2] << 8 | data[3], quantum, flags & 1, flags & 2);
    draw(p, sg::rd_decode(p, data + kHeader, size - kHeader, flags & 4, kMostGaussians));
  } catch (const std::invalid_argument&) {
  } catch (const std::runtime_error&) {
  }
  return 0;
}
