// What differs between processors, compilers and systems. Vectors have simd.h, instruction sets isa.h.
#pragma once

#include <cstdint>
#include <cstdlib>

#if !defined(__GNUC__) && !defined(__clang__)
#error "The kernels need the vector extensions of GCC or Clang; on Windows, of clang-cl."
#endif
#if defined(__BYTE_ORDER__) && __BYTE_ORDER__ != __ORDER_LITTLE_ENDIAN__
#error "The kernels read numbers as little-endian machines keep them."
#endif

// x86-64 has several instruction sets, of which the best is chosen at run time. Elsewhere there is one: NEON on aarch64,
// or what the compiler makes of vectors.
#ifdef __x86_64__
#define SG_X86 1
#include <xmmintrin.h>
#else
#define SG_X86 0
#endif

#ifndef _WIN32
#define SG_FORKS 1
#include <pthread.h>
#else
#define SG_FORKS 0
#endif

// For loops that the compiler makes vectors of by itself: a function for several instruction sets, of which the loader
// picks one. Loaders other than glibc's cannot. Not under the thread sanitizer, which cannot watch it do so yet.
#if SG_X86 && defined(__GLIBC__) && !defined(__SANITIZE_THREAD__)
#define SG_CLONES __attribute__((target_clones("avx512f", "avx2", "default")))
#else
#define SG_CLONES
#endif

// The model of a thread's storage that needs no memory at the first use: there the system ends the process if it has none.
// Where the C library is musl, no first use needs any, and a library of that model is refused once a program runs.
#if defined(__ELF__) && defined(__GLIBC__)
#define SG_STORED_AT_START __attribute__((tls_model("initial-exec")))
#else
#define SG_STORED_AT_START
#endif

namespace sg {

// The processor's mode for numbers with a point, of this thread, and its part that makes subnormal numbers zero.
#if SG_X86
using FloatMode = unsigned;
constexpr FloatMode kFlushMode = 0x8040;
inline FloatMode float_mode() { return _mm_getcsr(); }
inline void set_float_mode(FloatMode mode) { _mm_setcsr(mode); }
#elif defined(__aarch64__)
using FloatMode = uint64_t;
constexpr FloatMode kFlushMode = 1 << 24;
inline FloatMode float_mode() {
  FloatMode mode;
  asm volatile("mrs %0, fpcr" : "=r"(mode));
  return mode;
}
inline void set_float_mode(FloatMode mode) { asm volatile("msr fpcr, %0" : : "r"(mode) : "memory"); }
#else
using FloatMode = unsigned;
constexpr FloatMode kFlushMode = 0;
inline FloatMode float_mode() { return 0; }
inline void set_float_mode(FloatMode) {}
#endif

// Tells the processor that this thread only waits.
inline void wait_a_moment() {
#if SG_X86
  _mm_pause();
#elif defined(__aarch64__)
  asm volatile("yield");
#endif
}

// Has `run` called in every child that is forked from now on.
inline int in_children(void (*run)()) {
#if SG_FORKS
  return pthread_atfork(nullptr, nullptr, run);
#else
  static_cast<void>(run);
  return 0;
#endif
}

}  // namespace sg
