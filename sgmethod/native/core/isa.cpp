#include "core/isa.h"

#include <algorithm>
#include <atomic>

#include "core/platform.h"

#if SG_X86
#include <cpuid.h>
#endif

namespace sg {
namespace {

std::atomic<int> highest{kAvx512};

#if SG_X86
// Features of the processor that the system supports. Queried once, because a virtual machine may answer slowly. Not by
// __builtin_cpu_supports, which some compilers' libraries lack.
struct Processor {
  Processor() {
    unsigned a, b, c, d, extended = 0;
    if (!__get_cpuid(1, &a, &b, &c, &d)) return;
    const bool avx = all(c, 1u << 27 | 1u << 28), fma = all(c, 1u << 12);  // bit 27: xgetbv is available
    const unsigned kept = avx ? registers_kept() : 0;
    if (__get_cpuid(0x80000001, &a, &b, &c, &d)) extended = c;
    if (!__get_cpuid_count(7, 0, &a, &b, &c, &d)) return;
    constexpr unsigned kAvx2Bit = 1u << 5, kBmi = 1u << 3 | 1u << 8, kLzcnt = 1u << 5;
    constexpr unsigned kAvx512Bits = 1u << 16 | 1u << 17 | 1u << 31;  // F, DQ, VL
    bit_operations = all(b, kBmi) && all(extended, kLzcnt);
    if (all(kept, 0x06) && fma && all(b, kAvx2Bit)) isa = kAvx2;
    if (isa == kAvx2 && all(kept, 0xE6) && all(b, kAvx512Bits)) isa = kAvx512;
  }
  static bool all(unsigned value, unsigned bits) { return (value & bits) == bits; }
  static unsigned registers_kept() {  // register sets that the system saves for each thread
    unsigned low, high;
    asm volatile("xgetbv" : "=a"(low), "=d"(high) : "c"(0));
    return low;
  }
  int isa = kBaseline;
  bool bit_operations = false;  // BMI1, BMI2 and LZCNT
};

const Processor& processor() {
  static const Processor found;
  return found;
}
#endif

}  // namespace

#if SG_X86
int best_isa() { return std::min(processor().isa, highest.load(std::memory_order_relaxed)); }
bool has_bit_operations() { return processor().bit_operations; }
#else
int best_isa() { return kBaseline; }
#endif

void limit_isa(int isa) { highest.store(isa, std::memory_order_relaxed); }

}  // namespace sg
