// The Python module. The files of this folder check and convert arguments; the rest is in the folders beside it.
#include <nanobind/nanobind.h>
#include <nanobind/stl/tuple.h>

#include <tuple>

#include "bindings/arrays.h"
#include "bindings/lock.h"
#include "core/constants.h"
#include "core/isa.h"
#include "core/platform.h"
#include "core/scratch.h"
#include "core/thread_pool.h"
#include "raster/levels.h"
#include "texture/texture.h"

namespace {

std::tuple<double, double, double> color_axis(int row) {
  const double* axis = sg::kColorBasis[row];
  return {axis[0], axis[1], axis[2]};
}

void in_parallel(int count, const nb::callable& task) {
  const Unlocked unlocked;
  sg::parallel_for(count, [&](int i) {
    const sg::WithMode mode;  // subnormal numbers stay
    const Locked locked;
    within_program([&] { task(i); });
  });
}

}  // namespace

NB_MODULE(_native, m) {
  nb::set_leak_warnings(false);  // a thread that works when the program ends keeps what it works on
  m.doc() = "The compiled kernels, as sgmethod/native/bindings/ gives them to Python.";
  m.attr("MAX_SIDE") = sg::kMaxSide;
  m.attr("MAX_CUTOFF") = sg::kMaxCutoff;
  m.attr("CUTOFF_V2") = sg::kCutoffV2;
  m.attr("TARGET_WHITE") = sg::kTargetWhite;
  m.attr("VISIBLE") = sg::kVisible;
  m.attr("COARSE_SIDE") = sg::kCoarseSide;
  m.attr("SEEN_COLOR") = sg::kSeenByEye.color;
  m.attr("SEEN_LUMA") = std::make_tuple(sg::kSeenByEye.luma[0], sg::kSeenByEye.luma[1], sg::kSeenByEye.luma[2]);
  m.attr("TILE_WIDTH") = sg::kTileWidth;
  m.attr("TILE_HEIGHT") = sg::kTileHeight;
  m.attr("TEXTURE_OCTAVES") = sg::kTextureOctaves;
  m.attr("TEXTURE_CELL") = sg::kTextureCell;
  m.attr("TEXTURE_STRENGTHS") = sg::kTextureStrengths;
  m.attr("COLOR_BASIS") = std::make_tuple(color_axis(0), color_axis(1), color_axis(2));
  m.attr("COLOR_SCALE") = sg::kColorScale;
  m.attr("R_STEP") = sg::kRStep;
  m.attr("MAX_LEVEL") = sg::kMaxLevel;
  m.attr("NARROWEST") = sg::kNarrowest;
  m.attr("MAX_SCALE") = sg::kMaxScale;
  m.attr("MAX_SLANT") = sg::kMaxSlant;
  m.attr("MAX_AMPLITUDE") = sg::kMaxAmplitude;
  m.attr("FAINT") = sg::kFaint;
  m.def("best_isa", &sg::best_isa, "Best instruction set of this processor: 0 the baseline, 1 AVX2, 2 AVX-512.");
  m.def("limit_isa", &sg::limit_isa, nb::arg("isa"));
  m.def("thread_count", &sg::thread_count,
        "Threads used by kernels, including the calling one; fewer if the system refuses to create them.");
  m.def("set_thread_count", &sg::set_thread_count, nb::arg("count"));
  m.def("in_parallel", &in_parallel, nb::arg("count"), nb::arg("task"),
        "Call task(0) to task(count - 1) on the kernels' threads; after an error, skip those that have not begun.");
  m.def("stay_alone", &sg::stay_alone,
        "From now on run the calling thread's kernels on it alone, at the same time as other threads run theirs.");
  m.def("release_memory", &sg::release_memory,
        "Return cached free memory to the system, before work that needs other sizes.");
  bind_raster(m);
  bind_fit(m);
  bind_rd(m);
}
