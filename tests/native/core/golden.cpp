// A golden file's pixels, which every machine must draw bit by bit.
#include <cstdint>
#include <cstdlib>
#include <memory>
#include <string>
#include <vector>

#include "check.h"
#include "core/constants.h"
#include "rd/lay_out.h"
#include "texture/texture.h"

namespace {

// Those of tests/data/v2/texture.sg; tests/native/test_core.py compares.
const sg::RdParameters kPicture(66, 200, 0.02001953125, false, false);
constexpr int kBackground = 120;
constexpr char kPayload[] =
    "aa1408005bdc2200d0829cc8bf7f345097fb92fc38915ef1caf9a30034016634291794681bab9438c31cd573d6132fac4186"
    "9fd0aa9a09a34b04a0b2a2d26cbe0ac7c92bf2f34fb6f106e3db73702f0d108e07a31c3ff8dbea27ac3318d38bbea31a4d94"
    "cbc1467f270807b233976bc03d94d3e3d687d963e14b6a92004716cd51951c07e1683ebe68f23829cebdd41621c508490866"
    "e56f2404cc8fc8745fcb6963c2b75cdf077cb5a03a338757c1b249a2a96efc411cb63d4100484b5e1a439a544902";
constexpr uint64_t kPixels = 0x6ae9b94d4565bdcf;  // their hash (FNV-1a)

std::vector<uint8_t> payload() {
  const std::string text = kPayload;
  std::vector<uint8_t> bytes;
  for (size_t i = 0; i < text.size(); i += 2)
    bytes.push_back(static_cast<uint8_t>(std::strtol(text.substr(i, 2).c_str(), nullptr, 16)));
  return bytes;
}

std::shared_ptr<const sg::Texture> texture() {
  uint8_t codes[sg::kTextureStrengths];  // two octaves of four rows of two cells
  for (int i = 0; i < sg::kTextureStrengths; ++i) codes[i] = static_cast<uint8_t>(i);
  return std::make_shared<const sg::Texture>(codes, sg::TextureGrid{2, 4, sg::kTextureCell, sg::kTextureCell, 0, 0, 0});
}

}  // namespace

TEST(a_golden_file_is_drawn_as_everywhere) {
  const std::vector<uint8_t> bytes = payload();
  const sg::LaidOut laid_out = sg::lay_out(kPicture, bytes.data(), bytes.size(), false, texture());
  std::vector<uint8_t> pixels(3 * static_cast<size_t>(kPicture.width * kPicture.height));
  const auto level = static_cast<float>(kBackground / 255.0);
  const float background[3] = {level, level, level};
  laid_out.raster->render_bytes(laid_out.colors.data(), background, pixels.data());
  uint64_t hash = 0xcbf29ce484222325;
  for (const uint8_t byte : pixels) hash = (hash ^ byte) * 0x100000001b3;
  CHECK(hash == kPixels);
}
