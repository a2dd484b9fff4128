// Adaptive models of 16 symbols, and rANS over them with two states (J. Duda, "Asymmetric numeral systems",
// 2013; interleaved as by F. Giesen, 2014). Integers only, so that every machine decodes the same. Decoding a symbol
// has no division and no branch that depends on the data.
//
// A symbol waits for the one before it in the same state, for some 30 cycles. So there are two states, and calling for
// symbols of the one and the other in turns decodes two in that time. Raw bits wait for neither.
//
// In a short file (docs/format.md) all symbols share one state: a second would cost more than its time is worth.
//
// All come from one sequence of bytes. A state takes two of them right after the symbol that leaves it low; raw bits
// take some right when they are fetched. So the bytes stand in the order in which a decoder needs them.
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <vector>

#include "core/simd.h"

namespace sg {

constexpr int kSymbols = 16;
constexpr int kProbabilityBits = 15;
constexpr uint32_t kProbabilityOne = 1u << kProbabilityBits;
constexpr uint32_t kStateLow = 1u << 16;  // a state is at least this, and below 2^32
constexpr size_t kStateBytes = 4, kWordBytes = 2;

// How models adapt. Edges move by 1 / 2^shift of the way towards where they would be if nothing but the symbol came: by
// shift 5 in the fast estimate, and in the slow one by 4 at first, later by up to 7.
struct Adaptation {
  static constexpr int kMinShare = 4, kRoom = (1 << kProbabilityBits) - kSymbols * kMinShare;
  static constexpr int kFastShift = 5, kSlowShift = 7, kStartShift = 4, kStartSeen = 16, kMaxSeen = 112;
  using Ends = int16_t[kSymbols][kSymbols];  // by symbol
  struct Stage {
    int64_t slow_shift = 0;
    uint16_t next = 0, slow_shifts = 0;  // index of the next stage; slow_shift less kStartShift
  };
  // Where the ends of all symbols go, and half of what the shift drops, so that it rounds.
  alignas(32) Ends fast = {}, slow[kSlowShift - kStartShift + 1] = {};
  Stage stages[kMaxSeen + 1] = {};  // by the number of symbols seen

  constexpr Adaptation() {
    set(fast, kFastShift);
    for (int k = 0; k <= kSlowShift - kStartShift; ++k) set(slow[k], k + kStartShift);
    for (int seen = 0; seen <= kMaxSeen; ++seen) {
      int shift = kStartShift;
      while ((seen + kStartSeen) >> (shift + 1) != 0) ++shift;
      stages[seen].slow_shift = shift;
      stages[seen].slow_shifts = static_cast<uint16_t>(shift - kStartShift);
      stages[seen].next = static_cast<uint16_t>(std::min(seen + 1, kMaxSeen));
    }
  }
  // The least end of symbol i, less kProbabilityOne.
  static constexpr int least_end(int i) { return kMinShare * (i + 1) - (1 << kProbabilityBits); }

 private:
  static constexpr void set(Ends& ends, int shift) {
    for (int symbol = 0; symbol < kSymbols; ++symbol)
      for (int i = 0; i + 1 < kSymbols; ++i)
        ends[symbol][i] = static_cast<int16_t>(least_end(i) + (i >= symbol ? kRoom : 0) + (1 << shift >> 1) - 1);
  }
};
inline constexpr Adaptation kAdaptation;

// The probabilities of 16 symbols: the mean of a fast and a slow estimate of the edges between them. Edges are kept
// less kProbabilityOne, so that the last is 0 and vectors compare them with signs.
class Model {
 public:
  Model() = default;
  // start: the cumulative probabilities below symbols 1 to 15, in 1/256.
  explicit Model(const uint8_t* start) {
    ends()[-1] = -kOne;
    for (int i = 0; i + 1 < kSymbols; ++i) {
      const int end = Adaptation::kRoom * start[i] / 256 + Adaptation::least_end(i);
      fast_[i] = slow_[i] = ends()[i] = static_cast<int16_t>(end);
    }
  }

  // Where symbol i begins, in 1/2^kProbabilityBits; no symbol's share is ever zero.
  uint32_t edge(int i) const { return static_cast<uint32_t>(kOne + ends()[i - 1]); }

  // The symbol within whose share a place lies, which is given less kProbabilityOne.
  SG_INLINE uint32_t find(int place) const { return count_until(ends(), place); }
  struct Share {
    int low, size;  // low less kProbabilityOne
  };
  SG_INLINE Share share(uint32_t symbol) const {
    const int16_t* end = ends() + symbol;
    return {end[-1], end[0] - end[-1]};
  }

  SG_INLINE void update(uint32_t symbol) {
    const Adaptation::Stage& stage = kAdaptation.stages[static_cast<uint16_t>(seen())];
    seen() = static_cast<int16_t>(stage.next);
    Lanes f = lanes(fast_), s = lanes(slow_);
    f += (lanes(kAdaptation.fast[symbol]) - f) >> Adaptation::kFastShift;
    s = shifted(lanes(kAdaptation.slow[stage.slow_shifts][symbol]) - s, stage.slow_shift) + s;
    lanes(fast_) = f;
    lanes(slow_) = s;
    lanes(ends()) = f + ((s - f) >> 1);
  }

 private:
  friend class Mean;
  // Vectors of the compiler, which makes one or two registers of each.
  typedef int16_t Lanes __attribute__((vector_size(32), may_alias));

  static SG_INLINE Lanes& lanes(int16_t* p) { return *reinterpret_cast<Lanes*>(p); }
  static SG_INLINE const Lanes& lanes(const int16_t* p) { return *reinterpret_cast<const Lanes*>(p); }

  static SG_INLINE Lanes shifted(Lanes v, const int64_t& by) { return v >> static_cast<int>(by); }

  static constexpr int kOne = kProbabilityOne;
  int16_t* ends() { return rest_ + kSymbols; }  // where each symbol ends; and right before, where the first begins
  const int16_t* ends() const { return rest_ + kSymbols; }
  int16_t& seen() { return rest_[0]; }

  alignas(32) int16_t fast_[kSymbols] = {}, slow_[kSymbols] = {}, rest_[2 * kSymbols] = {};
};

// The mean of two models' edges. Both adapt to the symbol.
class Mean {
 public:
  SG_INLINE Mean(Model& a, Model& b) : a_(a), b_(b) {
    ends_[kSymbols - 1] = -Model::kOne;
    const Model::Lanes x = Model::lanes(static_cast<const int16_t*>(a.ends()));
    const Model::Lanes y = Model::lanes(static_cast<const int16_t*>(b.ends()));
    Model::lanes(ends_ + kSymbols) = (x & y) + ((x ^ y) >> 1);  // no sum, which may exceed 16 bits
  }
  uint32_t edge(int i) const { return static_cast<uint32_t>(Model::kOne + ends_[kSymbols + i - 1]); }
  SG_INLINE uint32_t find(int place) const { return count_until(ends_ + kSymbols, place); }
  SG_INLINE Model::Share share(uint32_t symbol) const {
    const int16_t* end = ends_ + kSymbols + symbol;
    return {end[-1], end[0] - end[-1]};
  }
  SG_INLINE void update(uint32_t symbol) {
    a_.update(symbol);
    b_.update(symbol);
  }

 private:
  Model &a_, &b_;
  alignas(32) int16_t ends_[2 * kSymbols];
};

// Which state a symbol goes into, by what it says (models.h).
enum RansState { kColorState, kShapeState };
constexpr size_t kRansStates = 2;

// Records what is to be coded; the bytes come at the end.
class Encoder {
 public:
  static constexpr bool kCodesPlaces = true, kDecodes = false;

  // gaussians: how many will come, about.
  explicit Encoder(size_t gaussians) {
    steps_.reserve(kStepsExpected * gaussians);
    raw_.reserve(kRawExpected * gaussians);
  }

  template <typename Probabilities>
  SG_INLINE uint32_t symbol(RansState which, Probabilities&& model, uint32_t symbol) {
    const Model::Share share = model.share(symbol);
    steps_.push_back({static_cast<uint16_t>(share.low + static_cast<int>(kProbabilityOne)),
                      static_cast<uint16_t>(share.size), 0, static_cast<uint8_t>(which), false});
    model.update(symbol);
    return symbol;
  }

  // `count` raw bits, at most 56, come with the next calls of raw().
  SG_INLINE void fetch(int count) { steps_.push_back({0, 0, 0, static_cast<uint8_t>(count), false}); }
  // `count` bits, at most 32, of equal probability.
  SG_INLINE uint32_t raw(uint32_t value, int count) {
    pending_ |= (value & ((uint64_t{1} << count) - 1)) << bits_;
    for (bits_ += count; bits_ >= 8; bits_ -= 8, pending_ >>= 8) raw_.push_back(static_cast<uint8_t>(pending_));
    return value;
  }

  // used: number of states.
  std::vector<uint8_t> finish(size_t used) {
    raw_.push_back(static_cast<uint8_t>(pending_));
    // rANS codes backwards.
    std::array<uint32_t, kRansStates> states;
    states.fill(kStateLow);
    size_t words = 0;
    for (auto step = steps_.rbegin(); step != steps_.rend(); ++step) {
      if (step->share == 0) continue;
      uint32_t& state = states[step->which % used];
      step->refills = state >= static_cast<uint32_t>(step->share) << (32 - kProbabilityBits);
      if (step->refills) {
        step->word = static_cast<uint16_t>(state);
        state >>= 16;
        ++words;
      }
      state = (state / step->share << kProbabilityBits) + state % step->share + step->low;
    }
    std::vector<uint8_t> bytes;
    bytes.reserve(used * kStateBytes + words * kWordBytes + raw_.size() + 1);
    const auto put = [&](uint32_t value, size_t count) {
      for (size_t k = 0; k < count; ++k) bytes.push_back(static_cast<uint8_t>(value >> 8 * k));
    };
    for (size_t k = 0; k < used; ++k) put(states[k], kStateBytes);
    auto raw = raw_.begin();
    int left = 0;
    for (const Step& step : steps_) {
      if (step.refills) put(step.word, kWordBytes);
      if (step.share != 0) continue;
      for (; left < step.which; left += 8) bytes.push_back(raw == raw_.end() ? 0 : *raw++);
      left -= step.which;
    }
    return bytes;
  }

 private:
  static constexpr size_t kStepsExpected = 12, kRawExpected = 3;  // of a Gaussian
  struct Step {
    uint16_t low, share;  // of a symbol; share 0: raw bits
    uint16_t word;  // of the state before, if it refills
    uint8_t which;  // state, or number of raw bits
    bool refills;
  };
  std::vector<Step> steps_;
  std::vector<uint8_t> raw_;
  uint64_t pending_ = 0;  // raw bits, fewer than 8
  int bits_ = 0;
};

// Does not look for the end of the data, which kSlack zeros must follow. The caller compares read() with the size
// before these are used up. kStates: 1 where the symbols share a state, or kRansStates.
template <size_t kStates>
class Decoder {
 public:
  static constexpr bool kCodesPlaces = true, kDecodes = true;
  static constexpr size_t kSlack = 128;  // enough for 16 calls of symbol() or fetch()

  // data: what is to be read, and kSlack zeros.
  explicit Decoder(const uint8_t* data) : begin_(data), next_(data + kStates * kStateBytes) {
    std::memcpy(states_.data(), data, kStates * kStateBytes);
  }

  template <typename Probabilities>
  SG_INLINE uint32_t symbol(RansState which, Probabilities&& model, uint32_t = 0) {
    uint32_t& own = states_[which % kStates];
    const uint32_t state = own;
    const uint32_t symbol = model.find(static_cast<int>(state | kProbabilityOne));
    const Model::Share share = model.share(symbol);
    const int place = static_cast<int>(state & (kProbabilityOne - 1)) - static_cast<int>(kProbabilityOne);
    const uint32_t left =
        static_cast<uint32_t>(share.size) * (state >> kProbabilityBits) + static_cast<uint32_t>(place - share.low);
    uint16_t word;
    std::memcpy(&word, next_, sizeof word);
#if SG_X86
    // The compiler would make a branch of the condition, and that would be wrong half of the time.
    uint32_t filled = left;
    bool refill;
    asm("cmp %3, %0\n\tcmovb %2, %0" : "+r"(filled), "=@ccb"(refill) : "r"(left << 16 | word), "i"(kStateLow));
#else
    const bool refill = left < kStateLow;
    const uint32_t filled = refill ? left << 16 | word : left;
#endif
    own = filled;
    next_ += refill * kWordBytes;
    model.update(symbol);
    return symbol;
  }

  SG_INLINE void fetch(int count) {
    const auto bytes = static_cast<unsigned>(std::max(count - bits_, 0) + 7) / 8;
    uint64_t word;
    std::memcpy(&word, next_, sizeof word);
    raw_ |= (word & ((uint64_t{1} << 8 * bytes) - 1)) << bits_;
    bits_ += static_cast<int>(8 * bytes) - count;
    next_ += bytes;
  }
  SG_INLINE uint32_t raw(uint32_t, int count) {
    const uint64_t value = raw_ & ((uint64_t{1} << count) - 1);
    raw_ >>= count;
    return static_cast<uint32_t>(value);
  }

  size_t read() const { return static_cast<size_t>(next_ - begin_); }
  // Every state in use is at least kStateLow.
  bool begins() const { return *std::min_element(states_.begin(), states_.end()) >= kStateLow; }
  // Those of the end are the encoder's first, and no bits are left but zeros.
  bool ends() const {
    return raw_ == 0 && std::all_of(states_.begin(), states_.end(), [](uint32_t state) { return state == kStateLow; });
  }

 private:
  const uint8_t *begin_, *next_;
  std::array<uint32_t, kStates> states_;
  uint64_t raw_ = 0;
  int bits_ = 0;  // unread bits in raw_
};

}  // namespace sg
