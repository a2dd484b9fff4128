// What the Gaussians that are already decoded say about the next class: in which blocks of the picture its Gaussians
// are likely, and which way they point there (docs/format.md, "The map"). Nothing is drawn. Encoder and decoder compute
// the same, from single precision without fused operations and from integers, so every machine agrees.
//
// The map has the energy and the doubled direction of the gradient in blocks. From these, and from the class's
// Gaussians so far in the blocks around, two small networks (structure_net.h) predict how many Gaussians a block has. A
// block is divided into a power of two of parts, so that a Gaussian is expected in every 64 parts, and places are coded
// as distances counted in parts: likely blocks are long, unlikely ones short.
#pragma once

#include <algorithm>
#include <cstdint>
#include <cstring>
#include <vector>

#include "core/simd.h"

namespace sg {

constexpr int kEnergies = 9, kDirections = 26;  // contexts

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

class Structure {
 public:
  Structure(int width, int height) : width_(width), height_(height) {}

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
  Spot spot() const;
  Context context(const Spot& spot) const;

  // For the encoder: the block of a cell, the parts from the current one to the first of a later block, to which it
  // moves, and the number of a part within the current block by a Gaussian's place in it, which has x_bits, y_bits.
  uint32_t block_of(uint32_t column, uint32_t row) const;
  uint64_t to_block(uint32_t block);
  uint32_t part_of(uint64_t x, int x_bits, uint64_t y, int y_bits) const;
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
  std::vector<int16_t> own_;  // by numbers of Gaussians beside and around
  std::vector<uint16_t> counts_, above_, window_, column_sums_;
  Blocks pooled_, spare_;
  // The walk.
  int column_ = 0, row_ = 0, level_ = 0;
  uint32_t part_ = 0;
  uint16_t* at_ = nullptr;
};

}  // namespace sg
