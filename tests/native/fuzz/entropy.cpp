// Fuzz target (libFuzzer): the entropy decoder of profile rd, and the drawing of what it gives.
// Whatever the bytes are, they decode or are refused, and every instruction set draws the same.
#include <cstdint>
#include <cstdlib>
#include <memory>
#include <stdexcept>
#include <vector>

#include "core/constants.h"
#include "core/isa.h"
#include "core/thread_pool.h"
#include "raster/rasterization.h"
#include "rd/codec.h"
#include "texture/texture.h"

namespace {

constexpr size_t kHeader = 7;  // width, height, quantum, flags
enum Flags { kGrey = 1, kUpright = 2, kPrefix = 4, kFarOut = 8, kTexture = 16, kShort = 32 };
constexpr int kFarX = 65003, kFarY = 77;  // where a region may begin
constexpr int64_t kMaxPixels = 1 << 15;
constexpr uint64_t kMaxGaussians = 1 << 14;

std::vector<uint8_t> picture(const sg::GaussianArrays& g, const sg::Canvas& canvas, int isa, int64_t max_pairs) {
  const sg::Rasterization raster(g.means.data(), g.factors.data(), g.count(), canvas, isa, max_pairs);
  std::vector<uint8_t> pixels(3 * static_cast<size_t>(canvas.width) * canvas.height);
  const float background[3] = {0.0f, 0.5f, 1.0f};
  raster.render_bytes(g.colors.data(), background, pixels.data());
  return pixels;
}

// Strengths from the bytes of an input, over and over, in cells of a few pixels.
std::shared_ptr<const sg::Texture> texture_of(const uint8_t* data, size_t size, const sg::Canvas& canvas) {
  const sg::TextureGrid grid{canvas.width / 8 + 1, canvas.height / 8 + 1, 8.0, 7.5, canvas.x + 0.25,
                             canvas.y - 3.0,       data[0] % 5 - 2};
  std::vector<uint8_t> codes(static_cast<size_t>(sg::kTextureOctaves * grid.columns * grid.rows));
  for (size_t i = 0; i < codes.size(); ++i) codes[i] = data[i % size] % sg::kTextureStrengths;
  return std::make_shared<const sg::Texture>(codes.data(), grid);
}

void draw(const sg::RdParameters& p, sg::GaussianArrays g, int flags, const uint8_t* data, size_t size) {
  if (int64_t{p.width} * p.height > kMaxPixels) return;
  const int64_t max_pairs = sg::max_pairs_of(g.count(), p.width, p.height);
  sg::Canvas canvas{0, 0, p.width, p.height, sg::kCutoffV2, true};
  if (flags & kFarOut) {
    canvas.x = kFarX;
    canvas.y = kFarY;
    for (size_t i = 0; i < g.means.size(); ++i) g.means[i] += static_cast<float>(i % 2 ? kFarY : kFarX);
  }
  if (flags & kTexture) canvas.texture = texture_of(data, size, canvas);
  try {
    const std::vector<uint8_t> plain = picture(g, canvas, sg::kBaseline, max_pairs);
    for (int isa = sg::kAvx2; isa <= sg::best_isa(); ++isa)
      if (picture(g, canvas, isa, max_pairs) != plain) std::abort();
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
    const sg::RdParameters p(data[0] << 8 | data[1], data[2] << 8 | data[3], quantum, flags & kGrey, flags & kUpright,
                             flags & kShort);
    draw(p, sg::rd_decode(p, data + kHeader, size - kHeader, flags & kPrefix, kMaxGaussians), flags, data, size);
  } catch (const std::invalid_argument&) {
  } catch (const std::runtime_error&) {
  }
  return 0;
}
