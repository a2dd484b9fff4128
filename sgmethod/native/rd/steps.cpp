#include "rd/steps.h"

#include "core/scratch.h"
#include "core/thread_pool.h"
#include "fit/gradients.h"
#include "rd/rate.h"

namespace sg {
namespace {

constexpr int kBlock = 512;  // Gaussians of a task

}  // namespace

void rd_steps(const Descent& d, const float* rates, int steps, int n, const MutableGaussians& p, const Averages& a) {
  const auto count = static_cast<size_t>(n);
  Scratch gradients(8 * count), placed(d.spacing == 1 ? 0 : 5 * count);
  const Gradients by{gradients.get(), gradients.get() + 2 * count, gradients.get() + 5 * count};
  const float samples = 1 / d.spacing;
  for (int step = 0; step < steps; ++step) {
    const float *means = p.means, *factors = p.factors;
    if (d.spacing != 1) {
      float* const at = placed.get();
      for (size_t i = 0; i < 2 * count; ++i) at[i] = means[i] * samples;
      for (size_t i = 0; i < 3 * count; ++i) at[2 * count + i] = factors[i] * samples;
      means = at, factors = at + 2 * count;
    }
    const Rasterization raster(means, factors, n, d.canvas, -1, kMaxPairs);
    squared_error(raster, p.colors, d.target, by, d.visibility, d.seen);
    parallel_chunks(n, kBlock, [&](int first, int last, int) {
      for (int i = 2 * first; i < 2 * last; ++i) by.means[i] *= samples;
      for (int i = 3 * first; i < 3 * last; ++i) by.factors[i] *= samples;
      if (d.price > 0) add_rate_gradient(d.quantum, d.price, first, last, p.factors, p.colors, by.factors, by.colors);
      frame_adam(d.adam, rates[step], first, last, p, {by.means, by.factors, by.colors}, a.first, a.second, a.bias);
      keep_in_range(d.reach, d.width, d.height, first, last, p);
    });
  }
}

}  // namespace sg
