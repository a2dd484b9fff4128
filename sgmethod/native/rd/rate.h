// Profile rd: the price of bits, as the fit sees it. The fit moves real numbers, so the estimate is smooth.
#pragma once

namespace sg {

// Adds the gradient that Backend.add_rate_gradient (sgmethod/backend/protocol.py) describes to grad_factors [n, 3] and
// grad_colors [n, 3], for the Gaussians from first to before last.
void add_rate_gradient(float quantum, float weight, int first, int last, const float* factors, const float* colors,
                       float* grad_factors, float* grad_colors);

}  // namespace sg
