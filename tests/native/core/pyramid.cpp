// What refining takes from the pyramid against itself written down slowly, in double precision; tests/drawing and
// tests/backend have what is drawn and its gradients.
#include <algorithm>
#include <cmath>
#include <random>
#include <vector>

#include "check.h"
#include "core/constants.h"
#include "core/thread_pool.h"
#include "fit/gradients.h"
#include "fit/reduction.h"
#include "raster/levels.h"
#include "raster/planes.h"
#include "raster/rasterization.h"
#include "rd/codec.h"
#include "refine/gram.h"

namespace {

constexpr int kAll = 40;  // Gaussians of a picture
constexpr int kSizes[][2] = {{83, 70}, {33, 1}, {5, 130}};
constexpr double kTolerance = 1e-6;  // of the largest value; worst seen 2.4e-7

std::mt19937& random_numbers() {
  static std::mt19937 generator(2);
  return generator;
}

double between(double low, double high) { return std::uniform_real_distribution<double>(low, high)(random_numbers()); }

// The factor of an ellipse with these axes, in pixels, the major one at an angle to x.
std::vector<float> ellipse(double major, double minor, double angle) {
  const double x = std::cos(angle), y = std::sin(angle), m = major * major, n = minor * minor;
  const double l1 = std::sqrt(m * x * x + n * y * y), l2 = (m - n) * x * y / l1;
  return {static_cast<float>(l1), static_cast<float>(l2), static_cast<float>(major * minor / l1)};
}

// Gaussians around a picture, most of them wide.
sg::GaussianArrays scattered(int width, int height) {
  sg::GaussianArrays g;
  for (int i = 0; i < kAll; ++i) {
    g.means.push_back(static_cast<float>(between(-0.2, 1.2) * width));
    g.means.push_back(static_cast<float>(between(-0.2, 1.2) * height));
    const double minor = std::exp(between(-1, 4));
    const std::vector<float> factor = ellipse(minor * between(1, 4), minor, between(0, 3));
    g.factors.insert(g.factors.end(), factor.begin(), factor.end());
    for (int k = 0; k < 3; ++k) g.colors.push_back(static_cast<float>(between(-1, 1)));
  }
  return g;
}

// What a picture leaves of a grey target: in pixels, and reduced.
struct Residual {
  Residual(int width, int height, const sg::GaussianArrays& g)
      : raster(g.means.data(), g.factors.data(), kAll, {0, 0, width, height, sg::kCutoffV2, true}, -1, sg::kMaxPairs),
        strips(static_cast<size_t>(raster.grids()[0].strips() * height * 3 * sg::kTileWidth)),
        residual{strips.data(), width, height}, reduced(raster.grids()) {
    const std::vector<int16_t> target(static_cast<size_t>(3 * width * height), sg::kTargetWhite / 2);
    sg::draw_residual(raster, g.colors.data(), target.data(), residual, reduced);
  }
  sg::Rasterization raster;
  std::vector<float> strips;
  sg::Strips residual;
  sg::Planes reduced;
};

struct Matrix {
  Matrix(int rows, int columns) : rows(rows), columns(columns), values(static_cast<size_t>(rows) * columns) {}
  double& at(int row, int column) { return values[static_cast<size_t>(row) * columns + column]; }
  double at(int row, int column) const { return values[static_cast<size_t>(row) * columns + column]; }
  int rows, columns;
  std::vector<double> values;
};

Matrix product(const Matrix& a, const Matrix& b) {
  Matrix sums(a.rows, b.columns);
  for (int i = 0; i < a.rows; ++i)
    for (int k = 0; k < a.columns; ++k)
      for (int j = 0; j < b.columns; ++j) sums.at(i, j) += a.at(i, k) * b.at(k, j);
  return sums;
}

Matrix transposed(const Matrix& a) {
  Matrix t(a.columns, a.rows);
  for (int i = 0; i < a.rows; ++i)
    for (int j = 0; j < a.columns; ++j) t.at(j, i) = a.at(i, j);
  return t;
}

// Where sample i of a level has its centre, in pixels.
double centre(int i, int level) { return (i - (level > 0 ? sg::kBorder : 0) + 0.5) * std::ldexp(1.0, level); }

// The pixels [pixels, samples] of each sample of a level, along one axis: level by level a finer sample takes three
// quarters of the nearest coarse one and a quarter of the next.
Matrix enlarging(const std::vector<sg::Grid>& grids, int level, int sg::Grid::* side) {
  const auto samples = [&](int l) { return grids[static_cast<size_t>(l)].*side; };
  Matrix all(samples(0), samples(0));
  for (int i = 0; i < samples(0); ++i) all.at(i, i) = 1.0;
  for (int coarse = 1; coarse <= level; ++coarse) {
    Matrix once(samples(coarse - 1), samples(coarse));
    for (int i = 0; i < once.rows; ++i) {
      const double at = (centre(i, coarse - 1) - centre(0, coarse)) / std::ldexp(1.0, coarse);
      const int before = static_cast<int>(std::floor(at));
      for (const int k : {before, before + 1})
        if (k >= 0 && k < once.columns) once.at(i, k) = 1 - std::abs(at - k);
    }
    all = product(all, once);
  }
  return all;
}

// Of one level: enlarging down the rows and across the columns, and a level's Gaussian.
struct Level {
  Level(const std::vector<sg::Grid>& grids, int level)
      : grid(grids[static_cast<size_t>(level)]), down(enlarging(grids, level, &sg::Grid::height)),
        across(enlarging(grids, level, &sg::Grid::width)) {}
  Matrix enlarged(const Matrix& samples) const { return product(product(down, samples), transposed(across)); }
  Matrix reduced(const Matrix& picture) const { return product(product(transposed(down), picture), across); }
  sg::Grid grid;
  Matrix down, across;
};

// The largest difference of a level's red from what is expected, in parts of the largest value.
double difference(sg::Planes& planes, int level, const Matrix& expected) {
  double worst = 0, largest = 0;
  for (int y = 0; y < expected.rows; ++y)
    for (int x = 0; x < expected.columns; ++x) {
      worst = std::max(worst, std::abs(*planes.at(level, x, y) - expected.at(y, x)));
      largest = std::max(largest, std::abs(expected.at(y, x)));
    }
  return worst / largest;
}

Matrix red(sg::Planes& planes, int level) {
  Matrix values(planes.grid(level).height, planes.grid(level).width);
  for (int y = 0; y < values.rows; ++y)
    for (int x = 0; x < values.columns; ++x) values.at(y, x) = *planes.at(level, x, y);
  return values;
}

// Calls visit(i, level, its patch, its gain) for each Gaussian of a coarse level that is seen.
template <typename Visit>
void for_patches(const sg::GaussianArrays& g, const std::vector<sg::Grid>& grids, const Visit& visit) {
  const sg::Gram gram(grids, nullptr);
  for (size_t i = 0; i < kAll; ++i) {
    const int level = sg::level_of(&g.factors[3 * i]);
    if (level == 0) continue;
    const sg::Levelled own(&g.means[2 * i], &g.factors[3 * i], level);
    sg::Footprint f(own.mean, own.factor);
    f.decay = sg::decay_of(f.inv_l3);
    std::vector<sg::Span> spans;
    sg::spans(f, own.factor, std::sqrt(2 * sg::kCutoffV2), grids[static_cast<size_t>(level)],
              [&](const sg::Span& span) { spans.push_back(span); });
    if (spans.empty()) continue;
    sg::Patch patch;
    patch.draw(f, sg::exp_minus(sg::kCutoffV2), spans);
    gram.apply(level, patch);
    visit(i, level, patch, own.gain);
  }
}

// A patch's values on the grid; of(row) gives those of one of its rows.
template <typename Of>
Matrix on_grid(const sg::Patch& patch, const sg::Grid& grid, const Of& of) {
  Matrix values(grid.height, grid.width);
  for (int row = 0; row < patch.rows(); ++row)
    for (int column = 0; column < patch.columns(); ++column) {
      const int x = patch.x() + column, y = patch.y() + row;
      if (x >= 0 && y >= 0 && x < grid.width && y < grid.height) values.at(y, x) = of(row)[column];
    }
  return values;
}

}  // namespace

// A picture whose level 1 is reduced in more than one part.
TEST(levels_are_the_same_whether_level_1_is_kept_or_not) {
  const int threads = sg::thread_count();
  sg::set_thread_count(1);
  for (const int y : {0, 70}) {
    const sg::GaussianArrays g = scattered(4100, 600);
    const sg::Canvas part{0, y, 4100, 600, sg::kCutoffV2, true};
    const sg::Rasterization raster(g.means.data(), g.factors.data(), kAll, part, -1, sg::kMaxPairs);
    sg::Planes kept(raster.grids()), rest(raster.grids(), sg::Planes::Rows::kRoom, 2);
    std::vector<float> sums[2];
    for (const bool keeps : {true, false}) {
      std::vector<float>& own = sums[keeps];
      const auto each = [&](int tile, sg::Rasterization::Part&, float* values) {
        for (int i = 0; tile < raster.tiles(0) && i < sg::kTileFloats; ++i)
          values[i] = static_cast<float>((tile * 31 + i * 17) % 101 - 50);
        own.resize(std::max(own.size(), static_cast<size_t>(tile) + 1));
        float& sum = own[static_cast<size_t>(tile)];
        for (int i = 0; i < sg::kTileFloats; ++i) sum += values[i] * static_cast<float>(i % 7);
      };
      sg::Reduction(raster, each, keeps ? kept : rest).run();
    }
    CHECK(kept.top() >= 3 && sums[0] == sums[1]);
    for (int level = 2; level <= kept.top(); ++level) CHECK(red(kept, level).values == red(rest, level).values);
  }
  sg::set_thread_count(threads);
}

TEST(gram_products_are_those_of_enlarged_pictures) {
  for (const auto& [width, height] : kSizes) {
    const sg::GaussianArrays g = scattered(width, height);
    Residual residual(width, height, g);
    std::vector<Level> levels;
    for (int level = 0; level <= residual.reduced.top(); ++level) levels.emplace_back(residual.raster.grids(), level);
    for_patches(g, residual.raster.grids(), [&](size_t, int level, const sg::Patch& patch, float) {
      const Level& own = levels[static_cast<size_t>(level)];
      const Matrix weights = on_grid(patch, own.grid, [&](int row) { return patch.weights(row); });
      const Matrix found = on_grid(patch, own.grid, [&](int row) { return patch.product(row); });
      const Matrix expected = own.reduced(own.enlarged(weights)), reduced = red(residual.reduced, level);
      double worst = 0, largest = 0, energy = 0, projection = 0, size = 0;
      for (size_t k = 0; k < expected.values.size(); ++k) {
        worst = std::max(worst, std::abs(found.values[k] - expected.values[k]));
        largest = std::max(largest, expected.values[k]);
        energy += weights.values[k] * expected.values[k];
        projection += weights.values[k] * reduced.values[k];
        size += std::abs(weights.values[k] * reduced.values[k]);
      }
      float sums[4];
      sg::Gram::project(patch, level, residual.reduced, sums);
      CHECK(worst <= kTolerance * largest);
      CHECK(std::abs(sums[3] - energy) <= kTolerance * energy);
      CHECK(std::abs(sums[0] - projection) <= kTolerance * size);
    });
  }
}

TEST(a_gaussian_that_is_given_back_leaves_the_residual_of_the_others) {
  for (const auto& size : kSizes) {
    const int width = size[0], height = size[1];  // older Clangs capture no structured bindings
    const sg::GaussianArrays g = scattered(width, height);
    const Residual all(width, height, g);
    for_patches(g, all.raster.grids(), [&](size_t i, int level, const sg::Patch& patch, float gain) {
      sg::GaussianArrays rest = g;
      std::fill_n(&rest.colors[3 * i], 3, 0.0f);
      Residual others(width, height, rest), back(width, height, g);
      const float color[] = {gain * g.colors[3 * i], gain * g.colors[3 * i + 1], gain * g.colors[3 * i + 2]};
      sg::Gram::add(patch, level, color, back.reduced);
      CHECK(difference(back.reduced, level, red(others.reduced, level)) < kTolerance);
    });
  }
}
