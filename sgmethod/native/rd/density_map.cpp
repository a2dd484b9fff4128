#include "rd/density_map.h"

#include <cmath>
#include <cstring>
#include <utility>

#include "core/isa.h"
#include "rd/density_net.h"
#include "rd/symbols.h"

namespace sg {
namespace {

constexpr int kSmallestBlock = 3, kLargestBlock = 12;          // sides 2^3 to 2^12 pixels
constexpr uint64_t kMostBlocks = 1024, kBlocksPerGaussian = 8;  // of the map, for those so far
constexpr uint64_t kMostClassBlocks = 64, kBlocksPerOfClass = 8;  // within the picture, for a class
constexpr int kPartBits = 6;                  // a Gaussian is expected in 2^6 parts
constexpr int kOutside = 48;  // sixteenths of an octave, by which a block outside of the picture is less likely
constexpr float kSpread = 1.25f;
constexpr int kMostFeature = 255;

SG_INLINE int limited(int feature) { return std::clamp(feature, -kMostFeature, kMostFeature); }

struct Row {
  const float *energy, *around, *far, *direction;  // sums of the block, of 3x3, of 3x3 of 4x4; |x| + |y| of 3x3
  int columns, mean, group;
  int32_t* out;
};

// Predicts the logarithm of the Gaussians of each block in a row.
SG_INLINE void predict_body(const Row& r) {
  constexpr int kTogether = 64;
  for (int first = 0; first < r.columns; first += kTogether) {
    const int n = std::min(kTogether, r.columns - first);
    int32_t f[4][kTogether], sums[kTogether];
    for (int i = 0; i < n; ++i) {
      f[0][i] = limited(log_16(r.energy[first + i] + kTiny) - r.mean);
      f[1][i] = limited(log_16(r.around[first + i] + 9 * kTiny) - r.mean);
      f[2][i] = limited(log_16(r.far[first + i] + 144 * kTiny) - r.mean);
      f[3][i] = limited(log_16(r.direction[first + i] + kTiny) - log_16(r.around[first + i] + kTiny));
      sums[i] = kMapBase[r.group] * 64;
    }
    for (int h = 0; h < kMapUnits; ++h) {
      const int bias = kMapBias[r.group][h] * 64, out = kMapOut[h];
      const int w0 = kMapWeights[h][0], w1 = kMapWeights[h][1], w2 = kMapWeights[h][2], w3 = kMapWeights[h][3];
      for (int i = 0; i < n; ++i)
        sums[i] += out * (std::max(bias + w0 * f[0][i] + w1 * f[1][i] + w2 * f[2][i] + w3 * f[3][i], 0) >> 6);
    }
    for (int i = 0; i < n; ++i) r.out[first + i] = sums[i] >> 6;
  }
}
void predict_row(const Row& r) {
#if SG_X86
  if (best_isa() >= kAvx2) return for_avx2<predict_body, const Row&>(r);
#endif
  predict_body(r);
}

// Index of the class in tables.
int group_of(int size_class) { return std::clamp(size_class + 4, 0, kClassGroups - 1); }

// Logarithm of the mean energy of blocks.
int mean_energy(double energy, uint64_t blocks) {
  return log_16(static_cast<float>(energy / static_cast<double>(blocks)) + kTiny);
}

}  // namespace

void DensityMap::begin(int size_class, uint32_t count) {
  const int cell = cell_bits(size_class);
  class_ = size_class;
  count_ = std::max(count, 1u);
  known_ = gaussians_ > 0;
  const auto area = [&](int bits) {
    return static_cast<uint64_t>(blocks_along(width_, bits)) * static_cast<uint64_t>(blocks_along(height_, bits));
  };
  int bits = std::max(cell, kSmallestBlock);
  while (bits < kLargestBlock && area(bits) > kBlocksPerGaussian * gaussians_ + kMostBlocks) ++bits;
  if (bits_ < 0) {
    bits_ = bits;
    map_ = blocks(bits);
  }
  while (bits_ > bits) {  // a block becomes four
    Blocks finer = blocks(--bits_);
    for (int y = 0; y < finer.rows; ++y) {
      const Quad* from = &map_.of[static_cast<size_t>(((y - 2) >> 1) + 2) * map_.columns];
      Quad* to = &finer.of[static_cast<size_t>(y) * finer.columns];
      for (int x = 0; x < finer.columns; ++x) to[x] = from[((x - 2) >> 1) + 2] * 0.25f;
    }
    std::swap(map_, finer);
  }
  const auto inside = [&](int side, int by) { return static_cast<uint64_t>(((side - 1) >> by) + 1); };
  mean_ = mean_energy(energy_, inside(width_, bits_) * inside(height_, bits_));

  block_bits_ = bits_;
  while (block_bits_ < kLargestBlock &&
         inside(width_, block_bits_) * inside(height_, block_bits_) > kBlocksPerOfClass * count_ + kMostClassBlocks)
    ++block_bits_;
  halvings_ = block_bits_ - cell;
  width_in_blocks_ = blocks_along(width_, block_bits_);
  height_in_blocks_ = blocks_along(height_, block_bits_);
  blocks_ = inside(width_, block_bits_) * inside(height_, block_bits_);
  density_ = log_16((uint64_t{256} * count_) / blocks_ + 1) - 128;
  const size_t all = static_cast<size_t>(width_in_blocks_) * height_in_blocks_;
  base_.resize(all);
  const int base = density_ + 16 * kPartBits + 8;
  const int inside_columns = width_in_blocks_ - 2 * kRim, inside_rows = height_in_blocks_ - 2 * kRim;
  for (int y = 0; y < height_in_blocks_; ++y) {
    int16_t* const row = &base_[static_cast<size_t>(y) * width_in_blocks_];
    std::fill_n(row, width_in_blocks_, static_cast<int16_t>(base - kOutside));
    if (y >= kRim && y < kRim + inside_rows) std::fill_n(row + kRim, inside_columns, static_cast<int16_t>(base));
  }
  if (own_.empty()) own_.assign(kOwn1 * kOwn2, kUnknown);
  for (const uint32_t index : learned_) own_[index] = kUnknown;
  learned_.clear();
  if (known_) predict();
  const size_t stride = static_cast<size_t>(width_in_blocks_) + 2 * kPad;
  counts_.assign(stride * height_in_blocks_, 0);
  column_sums_.assign(stride, 0);
  above_.assign(width_in_blocks_, 0);
  window_.assign(width_in_blocks_, 0);
  column_ = row_ = 0;
  part_ = 0;
  at_ = &counts_[kPad];
  set_level();
}

// Sums of 3x3 blocks, row after row: along x and then down; what lies outside counts nothing.
class DensityMap::Sums {
 public:
  explicit Sums(const Blocks& of) : of_(of), columns_(static_cast<size_t>(of.columns)), along_(3 * columns_) { add(0); }

  // Calls sum(column, sum) for the blocks of the next row.
  template <typename Sum>
  void next(const Sum& sum) {
    add(row_ + 1);
    const Quad *const before = at(row_ + 2), *const here = at(row_), *const after = at(row_ + 1);
    for (size_t x = 0; x < columns_; ++x) sum(x, (before[x] + here[x]) + after[x]);
    ++row_;
  }

 private:
  Quad* at(int row) { return &along_[static_cast<size_t>(row % 3) * columns_]; }
  void add(int row) {
    Quad* const to = at(row);
    if (row == of_.rows) {
      std::fill(to, to + columns_, Quad{});
      return;
    }
    const Quad* const from = &of_.of[static_cast<size_t>(row) * columns_];
    to[0] = from[0] + from[1];
    for (size_t x = 1; x + 1 < columns_; ++x) to[x] = (from[x - 1] + from[x]) + from[x + 1];
    to[columns_ - 1] = from[columns_ - 2] + from[columns_ - 1];
  }

  const Blocks& of_;
  const size_t columns_;
  std::vector<Quad> along_;  // the rows before, here and after
  int row_ = 0;
};

// Adds to the base what the map says.
void DensityMap::predict() {
  const Blocks* of_class = &map_;
  for (int bits = bits_ + 1; bits <= block_bits_; ++bits) {
    pool(*of_class, bits, spare_);
    std::swap(pooled_, spare_);
    of_class = &pooled_;
  }
  Blocks twice, far;
  pool(*of_class, block_bits_ + 1, twice);
  pool(twice, block_bits_ + 2, far);
  const auto columns = static_cast<size_t>(of_class->columns);
  std::vector<float> floats(4 * columns + static_cast<size_t>(far.columns));
  float *const energy = floats.data(), *const around = energy + columns, *const direction = around + columns;
  float *const of_far = direction + columns, *const sums_of_far = of_far + columns;
  std::vector<int32_t> predicted(columns);
  const int mean = mean_energy(energy_, blocks_);
  Sums sums(*of_class), far_sums(far);
  for (int y = 0; y < of_class->rows; ++y) {
    const Quad* blocks = &of_class->of[static_cast<size_t>(y) * columns];
    sums.next([&](size_t x, const Quad& sum) {
      energy[x] = blocks[x][0];
      around[x] = sum[0];
      direction[x] = std::abs(sum[1]) + std::abs(sum[2]);
    });
    if (y == 0) far_sums.next([](size_t, const Quad&) {});
    if (y % 4 == 2 || y == 0) far_sums.next([&](size_t x, const Quad& sum) { sums_of_far[x] = sum[0]; });
    for (size_t x = 0; x < columns; ++x) of_far[x] = sums_of_far[(x + 6) / 4];
    predict_row({energy, around, of_far, direction, of_class->columns, mean, group_of(class_), predicted.data()});
    int16_t* base = &base_[static_cast<size_t>(y) * columns];
    for (size_t x = 0; x < columns; ++x) base[x] = static_cast<int16_t>(base[x] + predicted[x]);
  }
}

int DensityMap::learn(uint32_t beside, uint32_t around) {
  const uint64_t n1 = 256 * uint64_t{beside} * blocks_ / (6 * uint64_t{count_});
  const uint64_t n2 = 256 * uint64_t{around} * blocks_ / (40 * uint64_t{count_});
  const int f[3] = {log_16(n1 + 77) - 128, log_16(n2 + 77) - 128, density_};
  const int group = group_of(class_);
  int sum = 0;
  for (int h = 0; h < (known_ ? kOwnUnits : 0); ++h) {
    int unit = kOwnBias[group][h] * 64;
    for (int i = 0; i < 3; ++i) unit += kOwnWeights[h][i] * f[i];
    sum += kOwnOut[h] * (std::max(unit, 0) >> 6);
  }
  learned_.push_back(beside * kOwn2 + around);
  own_[learned_.back()] = static_cast<int16_t>(sum >> 6);
  return sum >> 6;
}

// False after the last row.
bool DensityMap::next_row() {
  if (++row_ == height_in_blocks_) return false;
  column_ = 0;
  at_ += 2 * kPad;
  const int stride = width_in_blocks_ + 2 * kPad;
  const uint16_t* before = &counts_[static_cast<size_t>(row_ - 1) * stride];
  uint16_t* const sums = column_sums_.data();
  for (int x = 0; x < stride; ++x) sums[x] = static_cast<uint16_t>(sums[x] + before[x]);
  if (row_ > 4) {
    const uint16_t* old = before - 4 * static_cast<int64_t>(stride);
    for (int x = 0; x < stride; ++x) sums[x] = static_cast<uint16_t>(sums[x] - old[x]);
  }
  for (int x = 0; x < width_in_blocks_; ++x) {
    uint16_t sum = 0;
    for (int d = 0; d < 9; ++d) sum = static_cast<uint16_t>(sum + sums[x + d]);
    window_[x] = sum;
    above_[x] = static_cast<uint16_t>(2 * before[x + 4] + before[x + 3] + before[x + 5]);
  }
  return true;
}

DensityMap::Blocks DensityMap::blocks(int bits) const {
  Blocks b;
  b.columns = blocks_along(width_, bits);
  b.rows = blocks_along(height_, bits);
  b.of.assign(static_cast<size_t>(b.columns) * b.rows, Quad{});
  return b;
}

// Sums of 2x2 blocks.
void DensityMap::pool(const Blocks& from, int bits, Blocks& to) const {
  to = blocks(bits);
  const Quad none{};
  for (int y = 1; y < to.rows; ++y) {
    const int row = 2 * y - 2;  // and the next, where there are such rows
    if (row >= from.rows) break;
    const Quad* upper = &from.of[static_cast<size_t>(row) * from.columns];
    const bool has_lower = row + 1 < from.rows;
    const Quad* lower = has_lower ? upper + from.columns : upper;
    Quad* out = &to.of[static_cast<size_t>(y) * to.columns];
    const auto column = [&](int x) { return upper[x] + (has_lower ? lower[x] : none); };
    const int pairs = from.columns / 2;
    if (has_lower) {
      for (int x = 0; x < pairs; ++x)
        out[x + 1] = (upper[2 * x] + lower[2 * x]) + (upper[2 * x + 1] + lower[2 * x + 1]);
    } else {
      for (int x = 0; x < pairs; ++x) out[x + 1] = column(2 * x) + column(2 * x + 1);
    }
    if (from.columns % 2 != 0) out[pairs + 1] = column(from.columns - 1);
  }
}

uint64_t DensityMap::to_block(uint32_t block) {
  uint64_t parts = 0;
  while (static_cast<uint32_t>(row_) * static_cast<uint32_t>(width_in_blocks_) + static_cast<uint32_t>(column_) <
         block) {
    const uint64_t rest = (uint64_t{1} << level_) - part_;
    parts += rest;
    advance(rest);
  }
  return parts;
}

void DensityMap::add(const float* means, const float* factors, const double* strengths, int n) {
  const float scale = static_cast<float>(std::ldexp(1.0, -bits_));
  gaussians_ += static_cast<uint64_t>(n);
  const Quad last_column = Quad{} + static_cast<float>(map_.columns - 1);
  const Quad last_row = Quad{} + static_cast<float>(map_.rows - 1), zero{};
  for (int i = 0; i < n; ++i) {
    const float *mean = means + 2 * i, *l = factors + 3 * i;
    const double l1 = l[0], l2 = l[1], l3 = l[2], xx = l1 * l1, xy = l1 * l2, yy = l2 * l2 + l3 * l3;
    const double by = strengths[i] / (l1 * l3);
    const Quad one{static_cast<float>(by * (xx + yy)), static_cast<float>(by * (yy - xx)),
                   static_cast<float>(by * (-2 * xy)), 0};
    energy_ += 4 * static_cast<double>(one[0]);
    // Four points of the covariance that the Gaussian has.
    const float d1 = kSpread * l[0], d2 = kSpread * l[1], d3 = kSpread * l[2];
    const Quad x = (mean[0] + Quad{d1, -d1, 0, 0}) * scale + 2.0f,
               y = (mean[1] + Quad{d2, -d2, d3, -d3}) * scale + 2.0f;
    const Quad column = Simd<4>::min(Simd<4>::max(x, zero), last_column);
    const Quad row = Simd<4>::min(Simd<4>::max(y, zero), last_row);
    for (int k = 0; k < 4; ++k)
      map_.of[static_cast<size_t>(static_cast<int>(row[k])) * map_.columns +
              static_cast<size_t>(static_cast<int>(column[k]))] += one;
  }
}

}  // namespace sg
