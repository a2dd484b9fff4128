// Vectors of W lanes and the few functions the kernels need, in the vector extensions of GCC and Clang, which work on
// every processor; in assembly where a compiler does worse than the processor could.
#pragma once

#include <cstdint>
#include <cstring>

#include "core/platform.h"

#if SG_X86
#include <emmintrin.h>
#elif defined(__ARM_NEON)
#include <arm_neon.h>
#endif

#define SG_INLINE inline __attribute__((always_inline))
#define SG_INLINE_LAMBDA __attribute__((always_inline))

#if SG_X86 && !defined(__clang__)
#define SG_GCC_ON_X86 1
#else
#define SG_GCC_ON_X86 0
#endif

// GCC uses vectors of half the width of AVX-512 unless told to prefer the full width. Clang has no such option.
#ifdef __clang__
#define SG_AVX512 "avx512f,avx512dq,avx512vl,fma"
#else
#define SG_AVX512 "avx512f,avx512dq,avx512vl,fma,prefer-vector-width=512"
#endif

namespace sg {

// Each calls a kernel's body, which is always inlined, and is compiled for one instruction set (isa.h).
template <auto body, typename... Arguments>
auto for_baseline(Arguments... arguments) {
  return body(arguments...);
}
#if SG_X86
template <auto body, typename... Arguments>
[[gnu::target("avx2,fma")]] auto for_avx2(Arguments... arguments) {
  return body(arguments...);
}
template <auto body, typename... Arguments>
[[gnu::target(SG_AVX512)]] auto for_avx512(Arguments... arguments) {
  return body(arguments...);
}
#endif

// Specialised for each width: GCC does not accept a vector_size that depends on a parameter.
template <int W>
struct Lanes;
#define SG_LANES(W)                                         \
  template <>                                               \
  struct Lanes<W> {                                         \
    typedef float F __attribute__((vector_size(4 * W)));    \
    typedef int32_t I __attribute__((vector_size(4 * W)));  \
    typedef uint32_t U __attribute__((vector_size(4 * W))); \
    typedef int16_t S __attribute__((vector_size(2 * W)));  \
  };
SG_LANES(4)
SG_LANES(8)
SG_LANES(16)
#undef SG_LANES

// Lanes of a and b, numbered consecutively, at the given places. Clang's builtin takes only constant places, but Clang
// recognises the unrolled loop.
template <typename V, typename Places>
SG_INLINE V shuffle(V a, V b, Places places) {
#ifdef __clang__
  constexpr int kLanes = sizeof a / sizeof a[0];
  V picked{};
#pragma clang loop unroll(full)
  for (int i = 0; i < kLanes; ++i) picked[i] = places[i] < kLanes ? a[places[i]] : b[places[i] - kLanes];
  return picked;
#else
  return __builtin_shuffle(a, b, places);
#endif
}

template <int W>
struct Simd {
  using F = typename Lanes<W>::F;
  using I = typename Lanes<W>::I;

  static SG_INLINE F load(const float* p) {
    F v;
    std::memcpy(&v, p, sizeof v);
    return v;
  }
  static SG_INLINE void store(float* p, F v) { std::memcpy(p, &v, sizeof v); }
  static SG_INLINE F all(float x) { return x - F{}; }
  static SG_INLINE F max0(F v) { return max(v, F{}); }
#if !SG_GCC_ON_X86
  static SG_INLINE F min(F a, F b) { return a < b ? a : b; }
  static SG_INLINE F max(F a, F b) { return a > b ? a : b; }
#else
  // The same: b if either is NaN. GCC would take two instructions, a comparison and a selection.
  static SG_INLINE F min(F a, F b) {
    if constexpr (W == 4) {
      asm("minps %1, %0" : "+x"(a) : "x"(b));
    } else {
      asm("vminps %1, %0, %0" : "+v"(a) : "v"(b));
    }
    return a;
  }
  static SG_INLINE F max(F a, F b) {
    if constexpr (W == 4) {
      asm("maxps %1, %0" : "+x"(a) : "x"(b));
    } else {
      asm("vmaxps %1, %0, %0" : "+v"(a) : "v"(b));
    }
    return a;
  }
#endif
  static SG_INLINE F sqrt(F v) {
#if !SG_GCC_ON_X86
    for (int i = 0; i < W; ++i) v[i] = __builtin_sqrtf(v[i]);
#else
    if constexpr (W == 4) {
      asm("sqrtps %0, %0" : "+x"(v));
    } else {
      asm("vsqrtps %0, %0" : "+v"(v));
    }
#endif
    return v;
  }
  static SG_INLINE float sum(F v) {
    float total = 0.0f;
    for (int i = 0; i < W; ++i) total += v[i];
    return total;
  }

  // For 8 lanes: four from each address.
  static SG_INLINE F halves(const float* low, const float* high) {
    static_assert(W == 8);
    F v;
#if !SG_GCC_ON_X86
    std::memcpy(&v, low, sizeof v / 2);
    std::memcpy(reinterpret_cast<char*>(&v) + sizeof v / 2, high, sizeof v / 2);
#else
    typedef float Four __attribute__((vector_size(16), aligned(4), may_alias));
    asm("vmovups %1, %x0\n\tvinsertf128 $1, %2, %0, %0"
        : "=&x"(v)
        : "m"(*reinterpret_cast<const Four*>(low)), "m"(*reinterpret_cast<const Four*>(high)));
#endif
    return v;
  }

  // For 8 lanes, clamped to 0 ... 255: in each half four bytes of a, four of b, and four of c twice.
  static SG_INLINE auto bytes(I a, I b, I c) {
    static_assert(W == 8);
    typedef uint8_t Bytes __attribute__((vector_size(32)));
    Bytes out;
#if !SG_GCC_ON_X86
    const I in[4] = {a, b, c, c};
    for (int i = 0; i < 32; ++i) {
      const int32_t v = in[i / 4 % 4][i / 16 * 4 + i % 4];
      out[i] = static_cast<uint8_t>(v < 0 ? 0 : v > 255 ? 255 : v);
    }
#else
    asm("vpackssdw %3, %2, %0\n\tvpackssdw %1, %1, %1\n\tvpackuswb %1, %0, %0" : "=&x"(out), "+x"(c) : "x"(a), "x"(b));
#endif
    return out;
  }

  // out [8]: the sum of each vector's lanes.
  static SG_INLINE void sums(const F (&v)[8], float* out) {
    for (int half = 0; half < 2; ++half) {
      const F* four = v + 4 * half;
      alignas(64) float parts[W];  // in each group of four lanes: the four vectors' sums over that group
      store(parts, pairs(pairs(four[0], four[1]), pairs(four[2], four[3])));
      auto sum = Simd<4>::load(parts);
      for (int lane = 4; lane < W; lane += 4) sum += Simd<4>::load(parts + lane);
      Simd<4>::store(out + 4 * half, sum);
    }
  }

  // In each group of four lanes: sums of neighbouring lanes, two of a and then two of b.
  static SG_INLINE F pairs(F a, F b) {
    I even, odd;
    for (int lane = 0; lane < W; ++lane) {
      even[lane] = lane / 4 * 4 + lane % 2 * 2 + (lane % 4 < 2 ? 0 : W);
      odd[lane] = even[lane] + 1;
    }
    return shuffle(a, b, even) + shuffle(a, b, odd);
  }

  // x = exp(x) for -87 <= x <= 87, relative error below 3e-7 (measured against double).
  // exp(x) = 2^n exp(r), r = x - n ln 2 in two parts (Cody and Waite), |r| <= 0.35, Taylor to degree 6.
  // Operations on one vector depend on each other, so each is done for all N vectors before the next: a processor looks
  // ahead only some dozens of operations.
  template <int N>
  static SG_INLINE void exp(F (&x)[N]) {
    const float magic = 12582912.0f;  // 1.5 * 2^23: adding it rounds to an integer in the low bits
    constexpr float kTaylor[] = {1.0f / 720.0f, 1.0f / 120.0f, 1.0f / 24.0f, 1.0f / 6.0f, 0.5f, 1.0f, 1.0f};
    F shifted[N], p[N];
    for (int i = 0; i < N; ++i) shifted[i] = x[i] * 1.44269504f + magic;
    for (int i = 0; i < N; ++i) {
      const F n = shifted[i] - magic;
      x[i] = (x[i] - n * 0.693359375f) - n * -2.12194440e-4f;
    }
    for (int i = 0; i < N; ++i) p[i] = x[i] * kTaylor[0] + kTaylor[1];
    for (int k = 2; k < 7; ++k)
      for (int i = 0; i < N; ++i) p[i] = p[i] * x[i] + kTaylor[k];
    for (int i = 0; i < N; ++i) {
      I bits;
      std::memcpy(&bits, &p[i], sizeof bits);
      I exponent;
      std::memcpy(&exponent, &shifted[i], sizeof exponent);
      bits += exponent << 23;  // the low bits of `shifted` hold n; higher bits fall out of the shift
      std::memcpy(&x[i], &bits, sizeof bits);
    }
  }
};

// Without a branch, so that the compiler vectorises loops that call it.
SG_INLINE double power_of_two(int exponent) {
  const uint64_t bits = static_cast<uint64_t>(1023 + exponent) << 52;
  double value;
  std::memcpy(&value, &bits, sizeof value);
  return value;
}

// Counts the numbers not greater than `place` among 16 ascending ones, of which the last is greater. p is aligned to 16
// bytes.
SG_INLINE uint32_t count_until(const int16_t* p, int place) {
#if SG_X86
  __m128i at = _mm_shufflelo_epi16(_mm_cvtsi32_si128(place), 0);
  at = _mm_unpacklo_epi64(at, at);
  const auto* v = reinterpret_cast<const __m128i*>(p);
  const __m128i low = _mm_cmpgt_epi16(_mm_load_si128(v), at), high = _mm_cmpgt_epi16(_mm_load_si128(v + 1), at);
  const __m128i above = _mm_packs_epi16(low, high);
  return static_cast<uint32_t>(__builtin_ctz(static_cast<unsigned>(_mm_movemask_epi8(above))));
#elif defined(__ARM_NEON) && defined(__aarch64__)
  const int16x8_t at = vdupq_n_s16(static_cast<int16_t>(place));  // a true comparison is -1
  const uint16x8_t within = vaddq_u16(vcleq_s16(vld1q_s16(p), at), vcleq_s16(vld1q_s16(p + 8), at));
  return static_cast<uint32_t>(-vaddvq_s16(vreinterpretq_s16_u16(within)));
#else
  uint32_t count = 0;
  for (int i = 0; i < 16; ++i) count += p[i] <= static_cast<int16_t>(place);
  return count;
#endif
}

}  // namespace sg
