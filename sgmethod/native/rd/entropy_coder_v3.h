// Version 3, which is only read: adaptive models of 16 symbols, and rANS over them (J. Duda, "Asymmetric numeral systems", 2013; state and
// words as in F. Giesen's public-domain rans_word_sse41). Integers only, so that every machine decodes the same. Decoding a
// symbol has no division and no branch that depends on the data.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <cstring>

#include "rd/entropy_coder.h"

namespace sg {

// The probabilities of 16 symbols: the mean of a fast and a slow estimate. Each estimate is a cumulative distribution in
// 1/65536. The first observations move both faster.
class alignas(16) ModelV3 {
 public:
  // start: the cumulative probabilities below symbols 1 to 15, in 1/256.
  explicit ModelV3(const uint8_t* start) {
    for (int i = 1; i < kSymbols; ++i) fast_[i] = slow_[i] = static_cast<uint16_t>(start[i - 1] << 8);
    edges_[kSymbols] = kProbabilityOne;  // never moves, like the first
    set_edges();
  }

  // Where symbol i begins, in 1/2^kProbabilityBits; no symbol's share is ever zero.
  uint32_t edge(int i) const { return edges_[i]; }

  // The symbol within whose share `place` lies.
  int find(uint32_t place) const {
    return static_cast<int>(count_until<false>(reinterpret_cast<const int16_t*>(edges_), static_cast<int>(place))) - 1;
  }

  void update(int symbol) {
    const int shift = 31 - __builtin_clz(seen_ + kStartSeen);
    if (seen_ < kMostSeen) ++seen_;
    constexpr Lanes kEach[2] = {{0, 1, 2, 3, 4, 5, 6, 7}, {8, 9, 10, 11, 12, 13, 14, 15}};
    for (int half = 0; half < 2; ++half) {
      const auto up = reinterpret_cast<Lanes>(kEach[half] > static_cast<uint16_t>(symbol));
      move(fast_ + 8 * half, up, std::min(shift, kFastShift));
      move(slow_ + 8 * half, up, std::min(shift, kSlowShift));
    }
    set_edges();
  }

 private:
  static constexpr int kFastShift = 5, kSlowShift = 7, kStartSeen = 16, kMostSeen = 128;

  typedef uint16_t Lanes __attribute__((vector_size(16), may_alias));

  static Lanes& lanes(uint16_t* p) { return *reinterpret_cast<Lanes*>(p); }
  // Towards 65535 where `up` is all ones, towards 0 elsewhere, by 1 / 2^shift of the way.
  static void move(uint16_t* p, Lanes up, int shift) {
    const Lanes v = lanes(p) ^ up;
    lanes(p) = (v - (v >> shift)) ^ up;
  }
  void set_edges() {
    constexpr Lanes kLeast = {0, 4, 8, 12, 16, 20, 24, 28};
    for (int i = 0; i < kSymbols; i += 8) {
      const Lanes f = lanes(fast_ + i), s = lanes(slow_ + i);
      const Lanes mean = (f | s) - ((f ^ s) >> 1);  // rounded up, without a seventeenth bit
      lanes(edges_ + i) = (mean >> 1) - (mean >> 10) + (kLeast + static_cast<uint16_t>(4 * i));
    }
  }

  alignas(16) uint16_t fast_[kSymbols] = {}, slow_[kSymbols] = {}, edges_[kSymbols + 1] = {};
  int seen_ = 0;
};

// Does not look for the end of the data, which kSlack zeros must follow. The caller compares read() with the size
// before these are used up.
class DecoderV3 {
 public:
  static constexpr size_t kSlack = 128;  // enough for 64 calls of symbol() or raw()

  // data: what is to be read, and kSlack zeros.
  explicit DecoderV3(const uint8_t* data) : begin_(data), next_(data + kStateBytes) {
    for (size_t i = 0; i < kStateBytes; ++i) state_ = state_ << 8 | data[i];
  }

  int symbol(ModelV3& model) {
    const uint32_t place = state_ & (kProbabilityOne - 1);
    const int symbol = model.find(place);
    const uint32_t low = model.edge(symbol);
    state_ = (model.edge(symbol + 1) - low) * (state_ >> kProbabilityBits) + place - low;
    model.update(symbol);
    refill();
    return symbol;
  }

  // `count` bits, at most 16, of equal probability.
  uint32_t raw(int count) {
    const uint32_t value = state_ & ((1u << count) - 1);
    state_ >>= count;
    refill();
    return value;
  }

  size_t read() const { return static_cast<size_t>(next_ - begin_); }
  bool begins() const { return state_ >= kStateLow; }  // as every state in use
  bool ends() const { return state_ == kStateLow; }    // the encoder's first

 private:
  void refill() {
    uint16_t word;
    std::memcpy(&word, next_, sizeof word);
    const bool low = state_ < kStateLow;
    const uint32_t filled = state_ << 16 | static_cast<uint16_t>(word << 8 | word >> 8);
    state_ = low ? filled : state_;
    next_ += low ? kWordBytes : 0;
  }

  const uint8_t *begin_, *next_;
  uint32_t state_ = 0;
};

}  // namespace sg
