// Instruction sets that the kernels are compiled for. Processors other than x86-64 have only the first.
#pragma once

namespace sg {

enum Isa { kBaseline = 0, kAvx2 = 1, kAvx512 = 2 };

// The best instruction set that this processor has, up to the limit.
int best_isa();
// Lets kernels use no better one, so that files of another machine can be made again. Call it before any kernel.
void limit_isa(int isa);
// Whether this processor has BMI1, BMI2 and LZCNT. On x86-64 only.
bool has_bit_operations();

}  // namespace sg
