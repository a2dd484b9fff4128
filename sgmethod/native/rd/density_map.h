// What the Gaussians that are already decoded say about the next class: in which blocks of the picture its Gaussians
// are likely, and which way they point there (docs/format.md, "The map"). Nothing is drawn. Encoder and decoder compute
// the same, from single precision without fused operations and from integers, so every machine agrees.
//
// The map has the energy and the doubled direction of the gradient in blocks. From these, and from the class's
// Gaussians so far in the blocks around, two small networks (density_net.h) predict how many Gaussians a block has. A
// block is divided into a power of two of parts, so that a Gaussian is expected in every 64 parts, and places are coded
// as distances counted in parts: likely blocks are long, unlikely ones short.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <vector>

#include "core/simd.h"

namespace sg {

constexpr int kEnergies = 9, kDirections = 26;  // contexts
constexpr float kTiny = 1.0f / 4096;  // added before a logarithm

// floor(16 log2 x), linear between powers of two, of a positive number.
SG_INLINE int log_16(float x) {
  int32_t bits;
  std::memcpy(&bits, &x, sizeof bits);
  return (bits >> 19) - 16 * 127;
}
// Every other of the lowest bits.
SG_INLINE uint32_t gather_bits(uint32_t v) {
  v &= 0x55555555;
  v = (v | v >> 1) & 0x33333333;
  v = (v | v >> 2) & 0x0F0F0F0F;
  v = (v | v >> 4) & 0x00FF00FF;
  return (v | v >> 8) & 0x0000FFFF;
}

// Sixteen bits, two places apart.
SG_INLINE uint32_t spread_bits(uint32_t v) {
  v = (v | v << 8) & 0x00FF00FF;
  v = (v | v << 4) & 0x0F0F0F0F;
  v = (v | v << 2) & 0x33333333;
  return (v | v << 1) & 0x55555555;
}

// What is known of a Gaussian's surroundings once its part is: contexts of its symbols, and how many times the part
// halves a cell along x and y (below 0: it is wider than a cell).
struct Context {
  uint8_t energy = 0, direction = 0;
  int8_t x_bits = 0, y_bits = 0;
};

// Part (x, y) of a block, which is divided into 2^x_bits by 2^y_bits parts, and the block's first cell.
struct Spot {
  int column = 0, row = 0;
  uint32_t x = 0, y = 0;
  int x_bits = 0, y_bits = 0;
};

class DensityMap {
 public:
  DensityMap(int width, int height) : width_(width), height_(height) {}

  // Begins a class of `count` Gaussians, at its first part.
  void begin(int size_class, uint32_t count);

  // Moves on by some parts. False if the class has no such part.
  SG_INLINE bool advance(uint64_t parts) {
    parts += part_;
    while (parts >> level_ != 0) {
      parts -= uint64_t{1} << level_;
      ++at_;
      if (++column_ == width_in_blocks_ && !next_row()) return false;
      set_level();
    }
    part_ = static_cast<uint32_t>(parts);
    return true;
  }
  // Counts a Gaussian in the current block.
  SG_INLINE void count() { *at_ = static_cast<uint16_t>(*at_ + (*at_ < kMostCounted)); }
  SG_INLINE Spot spot() const {
    const int x_bits = level_ / 2, y_bits = (level_ + 1) / 2, y_first = x_bits == y_bits;
    const auto first = [&](int block) { return (block - kRim) * (1 << halvings_) + 2; };
    return {first(column_), first(row_), gather_bits(part_ >> (1 - y_first)), gather_bits(part_ >> y_first),
            x_bits,         y_bits};
  }
  SG_INLINE Context context(const Spot& spot) const {
    Context c{0, 0, static_cast<int8_t>(spot.x_bits - halvings_), static_cast<int8_t>(spot.y_bits - halvings_)};
    if (!known_) return c;
    const int down = block_bits_ - bits_;
    const auto block = [&](int of_class, uint32_t part, int bits, int blocks) {
      const auto inside = static_cast<int>((uint64_t{part} << down) >> bits);
      return std::clamp((of_class - kRim) * (1 << down) + inside + kRim, 0, blocks - 1);
    };
    const int x = block(column_, spot.x, spot.x_bits, map_.columns), y = block(row_, spot.y, spot.y_bits, map_.rows);
    const Quad sum = around(x, y);
    const float energy = sum[0];
    c.energy = static_cast<uint8_t>(1 + std::clamp((log_16(energy * (1 / 9.0f) + kTiny) - mean_ + 96) / 24, 0, 7));
    // Without branches, which nothing could predict.
    const double dx = sum[1], dy = sum[2], e = energy, square = dx * dx + dy * dy, ax = std::abs(dx), ay = std::abs(dy);
    const int coherence = (5 * square >= e * e) + ((5 * square >= e * e) & (2 * square >= e * e));
    const int flat = 5 * ay < 2 * ax, steep = 5 * ax < 2 * ay, right = dx > 0, down_ = dy > 0;
    static constexpr uint8_t kOctants[16] = {5, 4, 6, 4, 7, 0, 6, 0, 3, 4, 2, 4, 1, 0, 2, 0};
    const int octant = kOctants[flat | steep << 1 | right << 2 | down_ << 3];
    const bool none = (25 * square < e * e) | (e == 0);
    c.direction = static_cast<uint8_t>(none ? 1 : 2 + 8 * coherence + octant);
    return c;
  }

  // For the encoder: the block of a cell, the parts from the current one to the first of a later block, to which it
  // moves, and the number of a part within the current block by a Gaussian's place in it, which has x_bits, y_bits.
  SG_INLINE uint32_t block_of(uint32_t column, uint32_t row) const {
    const auto block = [&](uint32_t cell) { return ((static_cast<int>(cell) - 2) >> halvings_) + kRim; };
    return static_cast<uint32_t>(block(row)) * static_cast<uint32_t>(width_in_blocks_) +
           static_cast<uint32_t>(block(column));
  }
  uint64_t to_block(uint32_t block);
  SG_INLINE uint32_t part_of(uint64_t x, int x_bits, uint64_t y, int y_bits) const {
    const int by_x = level_ / 2, by_y = (level_ + 1) / 2, y_first = by_x == by_y;
    const auto part = [](uint64_t place, int bits, int by) {
      return static_cast<uint32_t>(by <= bits ? place >> (bits - by) : place << (by - bits));
    };
    return spread_bits(part(x, x_bits, by_x)) << (1 - y_first) | spread_bits(part(y, y_bits, by_y)) << y_first;
  }
  size_t blocks() const { return base_.size(); }
  int halvings() const { return halvings_; }  // of a block down to a cell
  uint32_t part() const { return part_; }

  // Adds a class's Gaussians, which are decoded. strengths: |colour|^2 in steps, divided by 4 and by the nominal size's
  // square.
  void add(const float* means, const float* factors, const double* strengths, int n);

 private:
  static constexpr int kRim = 2;  // blocks of the map beyond each edge of the picture
  static constexpr int kPad = 4;  // zeros beside each row of counts
  static constexpr int kOwn1 = 64, kOwn2 = 256;
  static constexpr uint16_t kMostCounted = 255;
  static constexpr int16_t kUnknown = -32768;
  static constexpr int kMaxLevel = 20;

  // The energy of a block's gradient, and twice its direction times that.
  typedef float Quad __attribute__((vector_size(16)));
  struct Blocks {
    std::vector<Quad> of;
    int columns = 0, rows = 0;
  };

  int blocks_along(int side, int bits) const { return ((side - 1) >> bits) + 1 + 2 * kRim; }
  // The sum of 3x3 blocks of the map: along x and then down; what lies outside counts nothing.
  SG_INLINE Quad around(int x, int y) const {
    const Quad* at = &map_.of[static_cast<size_t>(y) * static_cast<size_t>(map_.columns) + static_cast<size_t>(x)];
    const int up = map_.columns;
    if (__builtin_expect(x > 0 && y > 0 && x + 1 < map_.columns && y + 1 < map_.rows, 1))
      return (((at[-up - 1] + at[-up]) + at[-up + 1]) + ((at[-1] + at[0]) + at[1])) +
             ((at[up - 1] + at[up]) + at[up + 1]);
    Quad rows[3] = {};
    for (int d = -1; d <= 1; ++d) {
      if (y + d < 0 || y + d >= map_.rows) continue;
      const Quad* row = at + d * up;
      rows[d + 1] = ((x > 0 ? row[-1] : Quad{}) + row[0]) + (x + 1 < map_.columns ? row[1] : Quad{});
    }
    return (rows[0] + rows[1]) + rows[2];
  }
  Blocks blocks(int bits) const;
  void pool(const Blocks& from, int bits, Blocks& to) const;
  void predict();
  class Sums;
  bool next_row();
  SG_INLINE void set_level() {
    uint64_t left;  // the four blocks before this, the nearest in the highest bits
    std::memcpy(&left, at_ - kPad, sizeof left);
#if __BYTE_ORDER__ == __ORDER_BIG_ENDIAN__
    const uint32_t nearest = left & 0xFFFF;
#else
    const auto nearest = static_cast<uint32_t>(left >> 48);
#endif
    const uint32_t beside = std::min<uint32_t>(above_[column_] + 2 * nearest, kOwn1 - 1);
    const uint32_t around =
        std::min<uint32_t>(window_[column_] + static_cast<uint32_t>(left * 0x0001000100010001 >> 48), kOwn2 - 1);
    int own = own_[beside * kOwn2 + around];
    if (__builtin_expect(own == kUnknown, 0)) own = learn(beside, around);
    level_ = std::clamp(
        (base_[static_cast<size_t>(row_) * static_cast<size_t>(width_in_blocks_) + static_cast<size_t>(column_)] +
         own) >>
            4,
        0, kMaxLevel);
  }
  int learn(uint32_t beside, uint32_t around);

  const int width_, height_;
  // The map.
  int bits_ = -1;  // of a block's side
  Blocks map_;
  double energy_ = 0;  // of all Gaussians so far
  uint64_t gaussians_ = 0;
  int mean_ = 0;  // logarithm of the map's mean energy
  // The class.
  int class_ = 0, block_bits_ = 0, halvings_ = 0, width_in_blocks_ = 0, height_in_blocks_ = 0;
  uint64_t blocks_ = 1;  // within the picture
  uint32_t count_ = 1;
  bool known_ = false;  // whether there are larger Gaussians
  int density_ = 0;  // logarithm of Gaussians per block
  std::vector<int16_t> base_;  // of the logarithm of parts of a block
  std::vector<int16_t> own_;  // by numbers of Gaussians beside and around, as far as learned
  std::vector<uint32_t> learned_;  // indices of own_
  std::vector<uint16_t> counts_, above_, window_, column_sums_;
  Blocks pooled_, spare_;
  // The walk.
  int column_ = 0, row_ = 0, level_ = 0;
  uint32_t part_ = 0;
  uint16_t* at_ = nullptr;
};

}  // namespace sg
