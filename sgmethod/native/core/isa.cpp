#include "core/isa.h"

#include <cpuid.h>

namespace sg {

int best_isa() {
  if (__builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512dq") && __builtin_cpu_supports("avx512vl"))
    return kAvx512;
  return __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma") ? kAvx2 : kBaseline;
}

bool has_bit_operations() {
  constexpr unsigned kExtendedFeatures = 0x80000001, kLzcnt = 1u << 5;  // not every compiler knows it by name
  unsigned a, b, c = 0, d;
  return __builtin_cpu_supports("bmi") && __builtin_cpu_supports("bmi2") && __get_cpuid(kExtendedFeatures, &a, &b, &c, &d) &&
         (c & kLzcnt) != 0;
}

}  // namespace sg
