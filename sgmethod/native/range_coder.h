// Adaptive binary range coder (the carry-less coder of LZMA with finer probabilities): integers only, so that
// every machine decodes the same.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <vector>

namespace sg {

// The probability of a 0, in 1/65536, as the mean of a fast and a slow estimate. The first observations move it
// faster: with few symbols, learning time costs more than noise.
class Bit {
 public:
  uint32_t probability() const { return (static_cast<uint32_t>(fast_) + slow_) >> 1; }
  void update(int bit) {
    const int fast = seen_ < kFastShift ? seen_ + 1 : kFastShift;
    const int slow = seen_ < kSlowShift ? seen_ + 1 : kSlowShift;
    if (seen_ < kSlowShift) ++seen_;
    if (bit) {
      fast_ -= fast_ >> fast;
      slow_ -= slow_ >> slow;
    } else {
      fast_ += (65535 - fast_) >> fast;
      slow_ += (65535 - slow_) >> slow;
    }
  }

 private:
  static constexpr int kFastShift = 4, kSlowShift = 6;
  uint16_t fast_ = 32768, slow_ = 32768;
  uint8_t seen_ = 1;
};

constexpr uint32_t kTop = 1u << 24;
constexpr size_t kMaxOverrun = 8;  // zero bytes that an encoder may leave out at the end
// Splits the range; never empty on either side.
inline uint32_t split(uint32_t range, uint32_t probability) {
  const uint32_t p = probability < 64 ? 64 : probability > 65472 ? 65472 : probability;
  return (range >> 16) * p;
}

class RangeEncoder {
 public:
  static constexpr bool kDecodes = false;

  int bit(Bit& model, int value) {
    const uint32_t bound = split(range_, model.probability());
    if (value) {
      low_ += bound;
      range_ -= bound;
    } else {
      range_ = bound;
    }
    model.update(value);
    normalise();
    return value;
  }

  // `count` bits of equal probability, the most significant first.
  uint32_t raw(uint32_t value, int count) {
    while (count-- > 0) {
      range_ >>= 1;
      if ((value >> count) & 1) low_ += range_;
      normalise();
    }
    return value;
  }

  std::vector<uint8_t> finish() {
    for (int i = 0; i < 5; ++i) shift();
    // The decoder reads exactly these bytes, and zeros past the end.
    for (size_t i = 0; i < kMaxOverrun && bytes_.size() > 1 && bytes_.back() == 0; ++i) bytes_.pop_back();
    bytes_.erase(bytes_.begin());  // the first byte is always 0
    return std::move(bytes_);
  }

 private:
  void normalise() {
    while (range_ < kTop) {
      range_ <<= 8;
      shift();
    }
  }
  void shift() {
    if (low_ < 0xFF000000ull || low_ > 0xFFFFFFFFull) {
      const auto carry = static_cast<uint8_t>(low_ >> 32);
      for (; pending_ != 0; --pending_) {
        bytes_.push_back(static_cast<uint8_t>(cache_ + carry));
        cache_ = 0xFF;
      }
      cache_ = static_cast<uint8_t>(low_ >> 24);
    }
    ++pending_;
    low_ = (low_ & 0x00FFFFFF) << 8;
  }

  std::vector<uint8_t> bytes_;
  uint64_t low_ = 0, pending_ = 1;
  uint32_t range_ = 0xFFFFFFFF;
  uint8_t cache_ = 0;
};

class RangeDecoder {
 public:
  static constexpr bool kDecodes = true;

  RangeDecoder(const uint8_t* data, size_t size) : next_(data), end_(data + size) {
    for (int i = 0; i < 4; ++i) code_ = code_ << 8 | byte();
  }

  int bit(Bit& model, int = 0) {
    const uint32_t bound = split(range_, model.probability());
    const int value = code_ >= bound;
    if (value) {
      code_ -= bound;
      range_ -= bound;
    } else {
      range_ = bound;
    }
    model.update(value);
    normalise();
    return value;
  }

  uint32_t raw(uint32_t, int count) {
    uint32_t value = 0;
    while (count-- > 0) {
      range_ >>= 1;
      const uint32_t one = code_ >= range_;
      if (one) code_ -= range_;
      value = value << 1 | one;
      normalise();
    }
    return value;
  }

  // How many bytes past the end were read as zeros: more than kMaxOverrun mean that the data are cut.
  size_t overrun() const { return overrun_; }
  // False for a start that no encoder writes. Once true it stays so: code and range never need more than 32 bits.
  bool valid() const { return code_ < range_; }
  // Whether nothing but zeros was left unread.
  bool at_end() const {
    return std::all_of(next_, end_, [](uint8_t byte) { return byte == 0; });
  }

 private:
  void normalise() {
    while (range_ < kTop) {
      range_ <<= 8;
      code_ = code_ << 8 | byte();
    }
  }
  uint8_t byte() {
    if (next_ != end_) return *next_++;
    ++overrun_;
    return 0;
  }

  const uint8_t *next_, *end_;
  uint32_t range_ = 0xFFFFFFFF, code_ = 0;
  size_t overrun_ = 0;
};

}  // namespace sg
