// The instruction sets that the kernels are compiled for. On processors other than x86-64 there is the first alone.
#pragma once

namespace sg {

enum Isa { kBaseline = 0, kAvx2 = 1, kAvx512 = 2 };

// The best instruction set this processor has.
int best_isa();
// Whether this processor, of x86-64, has BMI1, BMI2 and LZCNT.
bool has_bit_operations();

}  // namespace sg
