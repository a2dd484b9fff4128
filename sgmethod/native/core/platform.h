// Differences between processors, compilers and systems. For vectors see simd.h, for instruction sets isa.h.
#pragma once

#include <cstdint>
#include <cstdlib>

#if !defined(__GNUC__) && !defined(__clang__)
#error "The kernels need the vector extensions of GCC or Clang; on Windows, of clang-cl."
#endif
#if defined(__BYTE_ORDER__) && __BYTE_ORDER__ != __ORDER_LITTLE_ENDIAN__
#error "The kernels need a little-endian machine."
#endif

// x86-64 has several instruction sets, of which the best is chosen at run time. Elsewhere there is one: NEON on
// aarch64, or the compiler's own code for vectors.
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

// For functions with auto-vectorised loops: compiled for several instruction sets, of which the loader picks one. Only
// glibc's loader can. Not under the thread sanitizer, which is not ready when the loader picks.
#if SG_X86 && defined(__GLIBC__) && !defined(__SANITIZE_THREAD__)
#define SG_CLONES __attribute__((target_clones("avx512f", "avx2", "default")))
#else
#define SG_CLONES
#endif

// Thread-local storage that is allocated with the thread and not at its first use, where glibc ends the process if
// there is no memory. musl always allocates it with the thread, and refuses to load a library of this model later.
#if defined(__ELF__) && defined(__GLIBC__)
#define SG_STORED_AT_START __attribute__((tls_model("initial-exec")))
#else
#define SG_STORED_AT_START
#endif

namespace sg {

// The floating-point mode of this thread: the plain one rounds to nearest, traps no exception and keeps subnormal
// numbers; further bits flush those to zero.
#if SG_X86
using FloatMode = unsigned;
constexpr FloatMode kPlainMode = 0x1F80, kFlushMode = 0x8040;
inline FloatMode float_mode() { return _mm_getcsr(); }
inline void set_float_mode(FloatMode mode) { _mm_setcsr(mode); }
#elif defined(__aarch64__)
using FloatMode = uint64_t;
constexpr FloatMode kPlainMode = 0, kFlushMode = 1 << 24;
inline FloatMode float_mode() {
  FloatMode mode;
  asm volatile("mrs %0, fpcr" : "=r"(mode));
  return mode;
}
inline void set_float_mode(FloatMode mode) { asm volatile("msr fpcr, %0" : : "r"(mode) : "memory"); }
#else
using FloatMode = unsigned;
constexpr FloatMode kPlainMode = 0, kFlushMode = 0;
inline FloatMode float_mode() { return 0; }
inline void set_float_mode(FloatMode) {}
#endif

// Sets this thread's whole mode, and gives back its caller's, which may round otherwise or trap exceptions.
class WithMode {
 public:
  explicit WithMode(FloatMode mode = kPlainMode) : saved_(float_mode()) { set_float_mode(mode); }
  ~WithMode() { set_float_mode(saved_); }
  WithMode(const WithMode&) = delete;
  WithMode& operator=(const WithMode&) = delete;

 private:
  FloatMode saved_;
};

// Tells the processor that this thread is waiting in a loop.
inline void wait_a_moment() {
#if SG_X86
  _mm_pause();
#elif defined(__aarch64__)
  asm volatile("yield");
#endif
}

// Calls `run` in every child forked from now on.
inline int in_children(void (*run)()) {
#if SG_FORKS
  return pthread_atfork(nullptr, nullptr, run);
#else
  static_cast<void>(run);
  return 0;
#endif
}

}  // namespace sg
