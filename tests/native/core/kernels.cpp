// The kernels on values that no encoder makes, on every instruction set: nothing may be read or written out of place.
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <random>
#include <stdexcept>
#include <vector>

#include "check.h"
#include "core/constants.h"
#include "core/isa.h"
#include "core/thread_pool.h"
#include "fit/gradients.h"
#include "fit/loss.h"
#include "fit/optimiser.h"
#include "raster/rasterization.h"
#include "rd/codec.h"
#include "rd/steps.h"
#include "rd/symbols.h"
#include "refine/refine.h"

namespace {

constexpr int kWidth = 83, kHeight = 70, kPixels = kWidth * kHeight;

std::mt19937& random_numbers() {
  static std::mt19937 generator(1);
  return generator;
}

float between(float low, float high) { return std::uniform_real_distribution<float>(low, high)(random_numbers()); }

// Gaussians around a picture; with `wild`, one value in ten is far from any picture's.
sg::GaussianArrays scattered(int n, bool wild) {
  constexpr float kNever[] = {0.0f,
                              -1.0f,
                              1e-30f,
                              1e30f,
                              -1e30f,
                              std::numeric_limits<float>::infinity(),
                              std::numeric_limits<float>::quiet_NaN(),
                              std::numeric_limits<float>::denorm_min()};
  const auto value = [&](float v) {
    const auto pick = random_numbers()();
    return wild && pick % 10 == 0 ? kNever[pick / 10 % 8] : v;
  };
  sg::GaussianArrays g;
  for (int i = 0; i < n; ++i) {
    g.means.push_back(value(between(-0.2f, 1.2f) * kWidth));
    g.means.push_back(value(between(-0.2f, 1.2f) * kHeight));
    g.factors.push_back(value(std::exp(between(-1, 4))));
    g.factors.push_back(value(between(-20, 20)));
    g.factors.push_back(value(std::exp(between(-1, 4))));
    for (int k = 0; k < 3; ++k) g.colors.push_back(value(between(-1, 1)));
  }
  return g;
}

// No file has a colour that is not finite.
std::vector<float> finite(std::vector<float> colors) {
  for (float& c : colors)
    if (!std::isfinite(c)) c = 1e30f;
  return colors;
}

sg::Rasterization rasterized(const sg::GaussianArrays& g, const sg::Canvas& canvas, int isa) {
  return {g.means.data(), g.factors.data(), g.count(), canvas, isa, sg::kMaxPairs};
}

std::vector<uint8_t> pixels(const sg::Rasterization& raster, const std::vector<float>& colors) {
  constexpr float kBackground[3] = {0.1f, 0.5f, 0.9f};
  std::vector<uint8_t> bytes(static_cast<size_t>(3 * raster.width() * raster.height()));
  raster.render_bytes(colors.data(), kBackground, bytes.data());
  return bytes;
}

}  // namespace

TEST(kernels_of_every_instruction_set_draw_the_same) {
  for (const bool wild : {false, true})
    for (const bool pyramid : {false, true}) {
      const sg::GaussianArrays g = scattered(300, wild);
      std::vector<std::vector<uint8_t>> pictures;
      for (int isa = sg::kBaseline; isa <= sg::best_isa(); ++isa) {
        const sg::Rasterization raster = rasterized(g, {0, 0, kWidth, kHeight, sg::kCutoffV2, pyramid}, isa);
        pixels(raster, g.colors);  // whatever that gives
        pictures.push_back(pixels(raster, finite(g.colors)));
        CHECK(pictures.back() == pictures.front());
      }
    }
}

TEST(kernels_draw_a_part_as_it_is_in_the_whole) {
  for (const bool wild : {false, true}) {
    const sg::GaussianArrays g = scattered(300, wild);
    const std::vector<float> colors = finite(g.colors);
    const std::vector<uint8_t> whole = pixels(rasterized(g, {0, 0, kWidth, kHeight, sg::kCutoffV2, true}, -1), colors);
    for (int k = 0; k < 60; ++k) {
      const int x = static_cast<int>(random_numbers()() % kWidth), y = static_cast<int>(random_numbers()() % kHeight);
      const int width = 1 + static_cast<int>(random_numbers()() % (kWidth - x));
      const int height = 1 + static_cast<int>(random_numbers()() % (kHeight - y));
      const sg::Canvas part{x, y, width, height, sg::kCutoffV2, true};
      std::vector<uint8_t> crop;
      for (int row = y; row < y + height; ++row)
        crop.insert(crop.end(), whole.begin() + 3 * (row * kWidth + x), whole.begin() + 3 * (row * kWidth + x + width));
      CHECK(pixels(rasterized(g, part, k % (sg::best_isa() + 1)), colors) == crop);
    }
  }
}

TEST(kernels_of_the_fit_stay_within_their_arrays) {
  for (const bool wild : {false, true}) {
    sg::GaussianArrays g = scattered(300, wild), by = g;
    std::vector<float> image(3 * kPixels), grad(3 * kPixels), target(3 * kPixels, 0.5f), bias(600, 0.5f);
    std::vector<float> first(2400), second(2400);
    const std::vector<int16_t> levels(3 * kPixels, sg::kTargetWhite / 2);
    sg::ReconstructionLoss loss(target.data(), kWidth, kHeight, 0.5f);
    for (const bool pyramid : {false, true})
      for (int isa = sg::kBaseline; isa <= sg::best_isa(); ++isa) {
        const sg::Rasterization raster = rasterized(g, {0, 0, kWidth, kHeight, sg::kMaxCutoff, pyramid}, isa);
        raster.render(g.colors.data(), image.data());
        loss(image.data(), grad.data());
        sg::backward(raster, g.colors.data(), grad.data(), by.rows());
        sg::squared_error(raster, g.colors.data(), levels.data(), by.rows());
        sg::gram(raster, g.colors.data(), by.colors.data());
      }
    sg::add_rate_gradient(0.1f, 1.0f, 0, 300, g.rows(), by.rows());
    const sg::AdamSettings settings(0.1f, 0.1f, 0.1f, 0.9f, 0.999f, 0.3f, 2.0f, 1000.0f);
    sg::frame_adam(settings, {nullptr, 0, 0, 1.0f, 0.0f}, 1.0f, 0, 300, g.rows(), by.rows(), {first.data(), second.data(), bias.data()});
    sg::keep_in_range(2.0f, kWidth, kHeight, 0, 300, g.rows());
  }
}

TEST(loss_of_pictures_without_a_whole_neighbourhood) {
  for (const int side : {1, 2, 3}) {
    const std::vector<float> target(3 * side * side, 0.5f), image(3 * side * side, 0.25f);
    std::vector<float> grad(image.size());
    CHECK(sg::ReconstructionLoss(target.data(), side, side, 0.5f)(image.data(), grad.data()) == 0.0625);
  }
}

TEST(kernels_refuse_what_cannot_be) {
  const float mean[2] = {}, factor[3] = {1, 0, 1};
  const auto raster = [&](int width, int height, float cutoff, int isa, int x = 0) {
    return [=, &mean, &factor] {
      sg::Rasterization(mean, factor, 1, {x, 0, width, height, cutoff, true}, isa, sg::kMaxPairs);
    };
  };
  const float nan = std::numeric_limits<float>::quiet_NaN();
  CHECK(check::throws<std::invalid_argument>(raster(0, 1, 3.0f, -1)));
  CHECK(check::throws<std::invalid_argument>(raster(1, INT32_MAX, 3.0f, -1)));
  CHECK(check::throws<std::invalid_argument>(raster(1, 1, nan, -1)));
  CHECK(check::throws<std::invalid_argument>(raster(1, 1, 5.6f, -1)));
  CHECK(check::throws<std::invalid_argument>(raster(1, 1, 3.0f, sg::best_isa() + 1)));
  CHECK(check::throws<std::invalid_argument>(raster(1, 1, 3.0f, -1, -1)));
  CHECK(check::throws<std::invalid_argument>(raster(1, 1, 3.0f, -1, INT32_MAX)));
  CHECK(check::throws<std::invalid_argument>([&] {
    sg::squared_error(rasterized({{0, 0}, {1, 0, 1}, {1, 1, 1}}, {1, 0, 1, 1, 3.0f, true}, -1), nullptr, nullptr, {});
  }));
  CHECK(check::throws<std::invalid_argument>([] { sg::RdParameters(0, 1, 1.0, false, false); }));
  CHECK(check::throws<std::invalid_argument>([] { sg::RdParameters(1, 65536, 1.0, false, false); }));
  CHECK(check::throws<std::invalid_argument>([] { sg::RdParameters(1, 1, std::nan(""), false, false); }));
}

TEST(codec_gives_back_what_rounding_leaves) {
  constexpr int kMany = 200;
  for (const bool wild : {false, true}) {
    const sg::RdParameters p(kWidth, kHeight, 0.05, false, false);
    const sg::GaussianArrays g = scattered(kMany, wild);
    sg::GaussianArrays rounded = g;
    sg::rd_quantise(p, g.rows(), kMany, rounded.rows());
    const std::vector<uint8_t> bytes = sg::rd_encode(p, g.rows(), kMany);
    size_t left = 0;
    for (size_t i = 0; i < kMany; ++i)
      left += rounded.colors[3 * i] != 0 || rounded.colors[3 * i + 1] != 0 || rounded.colors[3 * i + 2] != 0;
    CHECK(sg::rd_decode(p, bytes.data(), bytes.size(), false).means.size() == 2 * left);
    for (size_t cut = 0; cut < bytes.size(); ++cut) {
      const std::vector<uint8_t> part(bytes.begin(), bytes.begin() + static_cast<ptrdiff_t>(cut));
      CHECK(sg::rd_decode(p, part.data(), cut, true).means.size() <= 2 * left);
    }
  }
}

TEST(codec_refuses_nonsense) {
  for (int k = 0; k < 20000; ++k) {
    const sg::RdParameters p(kWidth, kHeight, 0.05, false, false, k % 2 == 0);
    std::vector<uint8_t> bytes(random_numbers()() % 60);
    for (uint8_t& byte : bytes) byte = static_cast<uint8_t>(random_numbers()());
    for (const bool prefix : {false, true}) {
      try {
        const sg::GaussianArrays g = sg::rd_decode(p, bytes.data(), bytes.size(), prefix);
        CHECK(g.means.size() <= 2 * (3 * bytes.size() + 64));
      } catch (const std::runtime_error&) {
      }
    }
  }
}

TEST(refining_keeps_the_limit_of_bytes) {
  for (const bool wild : {false, true}) {
    const sg::RdParameters p(kWidth, kHeight, 0.05, false, false);
    const sg::GaussianArrays g = scattered(100, wild);
    const std::vector<int16_t> target(3 * kPixels, sg::kTargetWhite / 2);
    const std::vector<uint8_t> bytes = sg::rd_refine(p, g.rows(), 100, target.data(), {0.01, 1, 60.0, 100});
    CHECK(bytes.size() <= 100);
  }
}

// Several cells of a coarse level are visited at once. The Gaussians reach to within some samples of where the areas of
// two of them touch, from both sides.
TEST(refining_is_the_same_for_every_number_of_threads) {
  constexpr int kLong = 1300, kShort = 40, kMany = 24;
  const sg::RdParameters p(kLong, kShort, 0.05, false, false);
  sg::GaussianArrays g;
  for (int i = 0; i < kMany; ++i) {
    const int touching = 64 + 128 * (1 + i % 4), side = i / 4 % 2 ? 1 : -1;
    g.means.push_back(2.0f * static_cast<float>(touching + 70 * side));
    g.means.push_back(between(0, kShort));
    for (const float v : {50.0f, 0.0f, 4.0f}) g.factors.push_back(v);
    for (int k = 0; k < 3; ++k) g.colors.push_back(between(-1, 1));
  }
  const std::vector<int16_t> target(3 * kLong * kShort, sg::kTargetWhite / 2);
  std::vector<std::vector<uint8_t>> found;
  for (const int threads : {1, 2, 5}) {
    sg::set_thread_count(threads);
    found.push_back(sg::rd_refine(p, g.rows(), kMany, target.data(), {0.01, 1, 60.0, 200}));
    CHECK(found.back() == found.front());
  }
}
