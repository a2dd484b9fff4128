// The headers of all versions as tables of their fields, from which they are read. sgmethod/bitstream/ has the same:
// tests/native/decoder/test_fields.py compares.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <stdexcept>

#include "core/errors.h"

namespace sg {

struct Field {
  int bytes;
  uint32_t low, high;  // of the value
  uint32_t also = low;  // one value more
};
constexpr std::array kHeaderV1 = {
    Field{1, 0, 1},      // profile
    Field{2, 1, 65535},  // width
    Field{2, 1, 65535},  // height
    Field{1, 1, 16},     // position_bits
    Field{1, 0, 16},     // groups
};
constexpr std::array kGroup = {
    Field{1, 1, 16},        // bitwidth
    Field{3, 1, 16777215},  // gaussians
};
constexpr auto header_of(uint32_t most_flags) {
  return std::array{
      Field{1, 0, most_flags},  // flags
      Field{2, 1, 65535},       // width
      Field{2, 1, 65535},       // height
      Field{2, 256, 3839, 0},   // quantum
      Field{1, 0, 255},         // red
      Field{1, 0, 255},         // green
      Field{1, 0, 255},         // blue
  };
}
constexpr auto kHeaderV3 = header_of(3), kHeaderV4 = header_of(15);
constexpr std::array kAlphaHeader = {
    Field{2, 256, 3839, 0},   // quantum
    Field{1, 0, 255},         // background
    Field{4, 0, 4294967295},  // bytes
};

// A field of version 5, in bits; of a short file the upper ones, of which the lower are copies. grows: the bits are a number
// n, n bits follow, and the value is 2^n plus these.
struct BitField {
  int bits, short_bits;
  bool grows = false;
};
constexpr std::array kHeaderV5 = {
    BitField{5, 5},        // flags
    BitField{4, 4, true},  // width
    BitField{4, 4, true},  // height
    BitField{12, 8},       // quantum
    BitField{8, 5},        // red
    BitField{8, 5},        // green
    BitField{8, 5},        // blue
};
constexpr std::array kAlphaHeaderV5 = {
    BitField{12, 8},       // alpha_quantum
    BitField{8, 5},        // alpha_background
    BitField{5, 5, true},  // alpha_bytes
};

template <size_t N>
constexpr size_t bytes_of(const std::array<Field, N>& fields) {
  size_t bytes = 0;
  for (const Field& field : fields) bytes += static_cast<size_t>(field.bytes);
  return bytes;
}
constexpr size_t kGroupBytes = bytes_of(kGroup), kAlphaBytes = bytes_of(kAlphaHeader);

inline void require(bool condition, const char* message) {
  if (!condition) refuse<std::runtime_error>(message);
}

inline uint32_t number(const uint8_t* p, int bytes) {
  uint32_t value = 0;
  for (int i = 0; i < bytes; ++i) value = value << 8 | p[i];
  return value;
}

// The values of a header's fields, which are all there.
template <size_t N>
std::array<uint32_t, N> values_of(const std::array<Field, N>& fields, const uint8_t* p) {
  std::array<uint32_t, N> values;
  for (size_t i = 0; i < N; p += fields[i++].bytes) {
    const auto& [bytes, low, high, also] = fields[i];
    const uint32_t value = values[i] = number(p, bytes);
    require((low <= value && value <= high) || value == also, "a header field is out of range");
  }
  return values;
}

// Codes bit by bit, the most significant first.
class Bits {
 public:
  explicit Bits(const uint8_t* p) : next_(p) {}
  const uint8_t* next() const { return next_; }
  uint32_t take(int count) {
    for (; left_ < count; left_ += 8) word_ = word_ << 8 | *next_++;
    left_ -= count;
    return static_cast<uint32_t>(word_ >> left_ & ((uint64_t{1} << count) - 1));
  }

 private:
  const uint8_t* next_;
  uint64_t word_ = 0;
  int left_ = 0;
};

// The fields of version 5, one after the other, from `size` bytes.
class HeaderBits {
 public:
  HeaderBits(const uint8_t* begin, size_t size, bool is_short) : bits_(begin), left_(8 * size), is_short_(is_short) {}
  // Of the first `count` fields; the others have the value of the last of these.
  template <size_t N>
  std::array<uint32_t, N> values_of(const std::array<BitField, N>& fields, size_t count = N) {
    std::array<uint32_t, N> values;
    for (size_t i = 0; i < N; ++i) values[i] = i < count ? value(fields[i]) : values[i - 1];
    return values;
  }
  // Where the whole bytes end that were read from.
  const uint8_t* end() {
    require(take(static_cast<int>(left_ % 8)) == 0, "the padding of the file's header is not zero");
    return bits_.next();
  }

 private:
  uint32_t take(int count) {
    require(left_ >= static_cast<size_t>(count), "the file ends within its header");
    left_ -= static_cast<size_t>(count);
    return bits_.take(count);
  }
  uint32_t value(const BitField& field) {
    const auto& [bits, short_bits, grows] = field;
    const uint32_t value = take(is_short_ ? short_bits : bits);
    if (grows) return 1u << value | take(static_cast<int>(value));
    return is_short_ ? value << (bits - short_bits) | value >> (2 * short_bits - bits) : value;
  }
  Bits bits_;
  size_t left_;
  bool is_short_;
};

}  // namespace sg
