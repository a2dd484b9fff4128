// Version 3: adaptive models of 16 symbols, and rANS over them (J. Duda, "Asymmetric numeral systems", 2013; state and
// words as in F. Giesen's public-domain rans_word_sse41). Integers only, so that every machine decodes the same. Decoding a
// symbol has no division and no branch that depends on the data.
#pragma once

#include <emmintrin.h>

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <vector>

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
    const __m128i p = _mm_set1_epi16(static_cast<int16_t>(place));
    const __m128i above = _mm_packs_epi16(_mm_cmpgt_epi16(at(edges_), p), _mm_cmpgt_epi16(at(edges_ + 8), p));
    return __builtin_ctz(static_cast<unsigned>(_mm_movemask_epi8(above)) | 1u << kSymbols) - 1;
  }

  void update(int symbol) {
    const int shift = 31 - __builtin_clz(seen_ + kStartSeen);
    if (seen_ < kMostSeen) ++seen_;
    const __m128i fast = _mm_cvtsi32_si128(std::min(shift, kFastShift));
    const __m128i slow = _mm_cvtsi32_si128(std::min(shift, kSlowShift));
    const __m128i s = _mm_set1_epi16(static_cast<int16_t>(symbol));
    const __m128i low = _mm_setr_epi16(0, 1, 2, 3, 4, 5, 6, 7), high = _mm_setr_epi16(8, 9, 10, 11, 12, 13, 14, 15);
    const __m128i up_low = _mm_cmpgt_epi16(low, s), up_high = _mm_cmpgt_epi16(high, s);
    move(fast_, up_low, fast);
    move(fast_ + 8, up_high, fast);
    move(slow_, up_low, slow);
    move(slow_ + 8, up_high, slow);
    set_edges();
  }

 private:
  static constexpr int kFastShift = 5, kSlowShift = 7, kStartSeen = 16, kMostSeen = 128;

  static __m128i at(const uint16_t* p) { return _mm_load_si128(reinterpret_cast<const __m128i*>(p)); }
  // Towards 65535 where `up` is all ones, towards 0 elsewhere, by 1 / 2^shift of the way.
  static void move(uint16_t* p, __m128i up, __m128i shift) {
    const __m128i v = _mm_xor_si128(at(p), up);
    _mm_store_si128(reinterpret_cast<__m128i*>(p), _mm_xor_si128(_mm_sub_epi16(v, _mm_srl_epi16(v, shift)), up));
  }
  void set_edges() {
    for (int i = 0; i < kSymbols; i += 8) {
      const __m128i mean = _mm_avg_epu16(at(fast_ + i), at(slow_ + i));
      const __m128i room = _mm_sub_epi16(_mm_srli_epi16(mean, 1), _mm_srli_epi16(mean, 10));
      const __m128i first = _mm_set1_epi16(static_cast<int16_t>(4 * i));
      const __m128i least = _mm_add_epi16(_mm_setr_epi16(0, 4, 8, 12, 16, 20, 24, 28), first);
      _mm_store_si128(reinterpret_cast<__m128i*>(edges_ + i), _mm_add_epi16(room, least));
    }
  }

  alignas(16) uint16_t fast_[kSymbols] = {}, slow_[kSymbols] = {}, edges_[kSymbols + 1] = {};
  int seen_ = 0;
};

// Records what is to be coded; rANS codes backwards, so the bytes come at the end.
class EncoderV3 {
 public:
  int symbol(ModelV3& model, int symbol) {
    const uint32_t low = model.edge(symbol);
    steps_.push_back({low, model.edge(symbol + 1) - low, 0});
    model.update(symbol);
    return symbol;
  }

  // `count` bits, at most 16, of equal probability.
  uint32_t raw(uint32_t value, int count) {
    steps_.push_back({value, 0, count});
    return value;
  }

  std::vector<uint8_t> finish() const {
    std::vector<uint8_t> reversed;
    const auto put = [&](uint32_t word) {
      reversed.push_back(static_cast<uint8_t>(word));
      reversed.push_back(static_cast<uint8_t>(word >> 8));
    };
    uint32_t state = kStateLow;
    for (auto step = steps_.rbegin(); step != steps_.rend(); ++step) {
      const uint64_t room = step->share ? static_cast<uint64_t>(step->share) << (32 - kProbabilityBits)
                                        : uint64_t{1} << (32 - step->bits);
      if (state >= room) {
        put(state & 0xFFFF);
        state >>= 16;
      }
      state = step->share ? (state / step->share << kProbabilityBits) + state % step->share + step->low
                          : state << step->bits | step->low;
    }
    put(state & 0xFFFF);
    put(state >> 16);
    return {reversed.rbegin(), reversed.rend()};
  }

 private:
  struct Step {
    uint32_t low, share;  // of a symbol; share 0: raw bits
    int bits;
  };
  std::vector<Step> steps_;
};

// Does not look for the end of the data, which kSlack zeros must follow. Whoever decodes compares read() with the size
// before these are used up.
class DecoderV3 {
 public:
  static constexpr size_t kSlack = 128;  // enough for 64 calls of symbol() or raw()

  // data: what is to be read, and kSlack zeros.
  explicit DecoderV3(const uint8_t* data) : begin_(data), next_(data + kStateBytes) {
    for (size_t i = 0; i < kStateBytes; ++i) state_ = state_ << 8 | data[i];
  }

  int symbol(ModelV3& model, int = 0) {
    const uint32_t place = state_ & (kProbabilityOne - 1);
    const int symbol = model.find(place);
    const uint32_t low = model.edge(symbol);
    state_ = (model.edge(symbol + 1) - low) * (state_ >> kProbabilityBits) + place - low;
    model.update(symbol);
    refill();
    return symbol;
  }

  uint32_t raw(uint32_t, int count) {
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
