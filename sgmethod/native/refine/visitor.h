// A visit of one Gaussian. Rounding each Gaussian alone ignores that they overlap, and that their rounding errors add
// up. A visit compares candidates against the residual of all other Gaussians, and takes the cheapest: the Gaussian
// unchanged; one of its integers one up or one down, where that may gain (outlook.h); each of these with the then best
// colour; and no Gaussian at all. The cost is squared error plus price times bits.
//
// Let e be the residual of the others, w the weights of a candidate and c its colour. The squared error is |e|^2 - 2 c
// <w, e> + |c|^2 <w, w>, so four sums over the candidate's pixels give the error for every colour. For a Gaussian of a
// coarse level the sums are over samples of its level (gram.h), on which it stays.
#pragma once

#include <cmath>
#include <cstring>
#include <vector>

#include "core/isa.h"
#include "fit/fit_kernels.h"
#include "raster/levels.h"
#include "rd/models.h"
#include "refine/gram.h"
#include "refine/outlook.h"
#include "refine/refine.h"

namespace sg {
namespace {

constexpr double kPlaceBits = 7.4;  // of a distance, where a Gaussian is expected in every 64 parts
constexpr double kBitsOfColor = 6.0;   // most bits that another colour is expected to save; fewer would miss winners

// A coder that only counts bits. The models do not adapt.
struct BitCounter {
  static constexpr bool kCodesPlaces = false, kDecodes = false;
  double bits = 0;
  template <typename Probabilities>
  uint32_t symbol(RansState, const Probabilities& model, uint32_t symbol) {
    const int i = static_cast<int>(symbol);
    bits += kProbabilityBits - std::log2(static_cast<float>(model.edge(i + 1) - model.edge(i)));
    return symbol;
  }
  void fetch(int) {}
  uint32_t raw(uint32_t value, int count) {
    bits += count;
    return value;
  }
};

struct Candidate {
  Symbols symbols;
  float mean[2], factor[3], color[3];  // in pixels of the picture
  float place[2], shape[3];            // mean and factor in samples of the target
  int level;
  double cost;  // minus that of no Gaussian
};

// State shared by the visits of all Gaussians.
struct State {
  const RdParameters& p;
  const RefineSettings& settings;
  float floor, reach;
  Strips residual;  // of all Gaussians
  Planes* reduced;  // the residual reduced to coarse levels
  const Gram& gram;
  const int16_t* visibility;  // of each pixel, in the layout of one colour of `residual`; or null
  Models models;

  Candidate decoded(const Symbols& s) const {
    Candidate c{s, {}, {}, {}, {}, {}, 0, 0};
    if (s.empty()) return c;  // with scales of 0, which draw nothing
    dequantise(p, s, Geometry(s, Steps(s)), c.mean, c.factor, c.color);
    const float samples = std::ldexp(1.0f, -settings.halvings);
    for (int k = 0; k < 2; ++k) c.place[k] = c.mean[k] * samples;
    for (int k = 0; k < 3; ++k) c.shape[k] = c.factor[k] * samples;
    c.level = level_of(c.shape);
    return c;
  }

  // Change of the error if the Gaussian is subtracted from the residual (times = -2), or added to it (times = 2).
  // products: of FitKernels::project.
  double change(const Candidate& c, const float* products, double times) const {
    float seen[3] = {c.color[0], c.color[1], c.color[2]};
    if (visibility != nullptr) settings.seen.weigh(seen);
    double error = 0;
    for (int k = 0; k < 3; ++k)
      error += seen[k] * (static_cast<double>(c.color[k]) * products[3] + times * products[k]);
    return error;
  }

  double bits(const Symbols& s) {
    BitCounter counter;
    Begun begun;
    NoWalk none;
    Symbols copy = s;
    const SizeClass c{s.size_class, 0, 0};
    models.turn<true, false>(counter, p, c, none, 0, begun, copy, copy);
    models.turn<false, true>(counter, p, c, none, 0, begun, copy, copy);
    return counter.bits + kPlaceBits;
  }
};

// A part of the picture, or of a coarse level: strips from strip0 to before strip1, rows from row0 to before row1.
struct Part {
  int strip0, strip1, row0, row1;
};

enum class Outcome { kSame, kChanged, kOutside };

// Visits Gaussians one by one. Those that need pixels outside a part of the picture are left unchanged.
class Visitor {
 public:
  Visitor(State& state, const Part& part) : state_(state), part_(part) {}

  Outcome visit(Symbols& s) {
    const Candidate now = state_.decoded(s);
    level_ = now.level;
    outside_ = false;
    add(now, 1.0f);
    if (outside_) return Outcome::kOutside;
    Candidate best{};  // no Gaussian
    best.cost = 0;
    try_steps(now, best);
    if (outside_) {  // restore the residual
      add(now, -1.0f);
      return Outcome::kOutside;
    }
    const bool changed = std::memcmp(&best.symbols, &s, sizeof s) != 0;
    s = best.symbols;
    if (!s.empty()) add(best, -1.0f);
    return changed ? Outcome::kChanged : Outcome::kSame;
  }

  void add(const Candidate& c, float sign) {
    const float color[3] = {sign * c.color[0], sign * c.color[1], sign * c.color[2]};
    if (c.level != 0) {
      const float gain = draw(c);
      if (gain == 0.0f) return;
      const float scaled[3] = {gain * color[0], gain * color[1], gain * color[2]};
      Gram::add(patch_, c.level, scaled, *state_.reduced);
      return;
    }
    const Footprint f = footprint(c.place, c.shape);
    const std::vector<Span>& spans = spans_of(f, c.shape, 0);
    fit_kernels(best_isa()).add(f, state_.floor, spans.data(), static_cast<int>(spans.size()), color, state_.residual);
  }

  void project(const Candidate& c, float* products) {
    if (c.level != 0) {
      std::fill_n(products, 4, 0.0f);
      const float gain = draw(c);
      if (gain == 0.0f) return;
      Gram::project(patch_, c.level, *state_.reduced, products);
      for (int k = 0; k < 3; ++k) products[k] *= gain;
      products[3] *= gain * gain;
      return;
    }
    const Footprint f = footprint(c.place, c.shape);
    const std::vector<Span>& spans = spans_of(f, c.shape, 0);
    fit_kernels(best_isa())
        .project(f, state_.floor, spans.data(), static_cast<int>(spans.size()), state_.residual, state_.visibility,
                 products);
  }

 private:
  static Footprint footprint(const float* mean, const float* factor) {
    Footprint f(mean, factor);
    f.decay = decay_of(f.inv_l3);
    return f;
  }

  // Compares a Gaussian, and those of its steps that may gain, with the best so far.
  void try_steps(const Candidate& now, Candidate& best) {
    float products[4];
    project(now, products);
    if (products[3] <= 0.0f) return;
    double ideal = state_.settings.price * state_.bits(now.symbols);
    const Outlook outlook = outlook_of(now, products, ideal);
    compare(now, products, best);
    for (int sign = -1; sign <= 1 && !outside_; sign += 2)
      for (int step = 0; step < Outlook::kSteps && !outside_; ++step) {
        Candidate c;
        if (ideal + outlook.least_change(step, sign) < best.cost && stepped(now, step, sign, c)) consider(c, best);
      }
  }

  // What steps may gain. Lowers the cost `ideal` by what the Gaussian itself gains in its best colour. Uses the spans,
  // and on coarse levels the patch, of the last project().
  Outlook outlook_of(const Candidate& now, const float* products, double& ideal) {
    const Levelled g(now.place, now.shape, now.level);
    const Footprint f = footprint(g.mean, g.factor);
    if (now.level == 0) patch_.draw(f, state_.floor, spans_);
    float color[3], seen[3], square = 0;
    for (int k = 0; k < 3; ++k) seen[k] = color[k] = products[k] / products[3];
    if (state_.visibility != nullptr) state_.settings.seen.weigh(seen);
    for (int k = 0; k < 3; ++k) square += seen[k] * color[k];
    const double energy = square * products[3];
    ideal -= energy;
    for (float& c : seen) c *= g.gain;
    Outlook outlook(seen, square * g.gain * g.gain, state_.floor);
    for (const Span& span : spans_) outlook.add(f, span, samples(span, now.level));
    const float scale = std::ldexp(1.0f, -now.level);
    outlook.finish(now.symbols, now.factor, scale * now.shape[0] / g.factor[0], scale * now.shape[2] / g.factor[2],
                   energy);
    return outlook;
  }

  SpanSamples samples(const Span& span, int level) {
    const int x = span.strip * kTileWidth, y = span.first_row;
    const int row = y - patch_.y(), column = x - patch_.x();
    SpanSamples s{patch_.weights(row) + column, nullptr, patch_.columns(), nullptr, 0, 0, nullptr};
    if (level == 0) {
      s.product = s.weights;
      s.residual = state_.residual.row(span.strip, y);
      s.residual_stride = 3 * kTileWidth;
      s.color_stride = kTileWidth;
      if (state_.visibility != nullptr)
        s.visibility = state_.visibility + (static_cast<int64_t>(span.strip) * state_.residual.height + y) * kTileWidth;
    } else {
      s.product = patch_.product(row) + column;
      s.residual = state_.reduced->at(level, x, y);
      s.residual_stride = state_.reduced->at(level, x, y + 1) - s.residual;
      s.color_stride = state_.reduced->stride(level);
    }
    return s;
  }

  // Sets c to a Gaussian with one of its integers one up or down. False if there is none.
  bool stepped(const Candidate& now, int step, int sign, Candidate& c) const {
    const Symbols& s = now.symbols;
    const Steps steps(s);
    if (step == Outlook::kU) {  // may lead to another size class, so the Gaussian is scaled and rounded again
      const float grow = std::exp(static_cast<float>(sign * kClassWidth * power_of_two(-steps.u_bits())));
      const float grown[3] = {now.factor[0] * grow, now.factor[1] * grow, now.factor[2] * grow};
      return quantised(now.mean, grown, now.color, s.context, c);
    }
    if (step == Outlook::kR && state_.p.upright) return false;
    Symbols moved = s;
    if (step == Outlook::kV) moved.v += sign;
    if (step == Outlook::kR) moved.r += sign;
    if (step == Outlook::kX) moved.px += sign;
    if (step == Outlook::kY) moved.py += sign;
    const Parts parts = parts_of(s, steps);
    if (!steps.allow(std::abs(moved.v), std::abs(moved.r))) return false;
    if (moved.px >> parts.x_bits || moved.py >> parts.y_bits) return false;
    c = state_.decoded(moved);
    if (step == Outlook::kX || step == Outlook::kY) return true;
    return quantised(now.mean, c.factor, c.color, s.context, c);  // another shape divides the cell differently
  }

  bool quantised(const float* mean, const float* factor, const float* color, const Context& context,
                 Candidate& c) const {
    Symbols s{};
    s.context = context;
    if (!in_range(factor, color) || !quantise(state_.p, mean, factor, color, s)) return false;
    c = state_.decoded(s);
    return true;
  }

  // Sets the patch to a Gaussian of a coarse level. Returns the gain of its colour; 0 if it covers no samples.
  float draw(const Candidate& c) {
    const Levelled g(c.place, c.shape, c.level);
    const Footprint f = footprint(g.mean, g.factor);
    const std::vector<Span>& spans = spans_of(f, g.factor, c.level);
    if (spans.empty()) return 0.0f;
    patch_.draw(f, state_.floor, spans);
    state_.gram.apply(c.level, patch_);
    return g.gain;
  }

  double cost(const Candidate& c, const float* products) {
    return state_.change(c, products, -2.0) + state_.settings.price * state_.bits(c.symbols);
  }

  void consider(const Candidate& c, Candidate& best) {
    if (c.level != level_) return;
    float products[4];
    project(c, products);
    if (products[3] > 0.0f) compare(c, products, best);
  }

  // Compares c with the best so far, first with its own colour, then with the best colours for its geometry.
  void compare(Candidate c, const float* products, Candidate& best) {
    c.cost = cost(c, products);
    if (c.cost < best.cost) best = c;
    Candidate ideal = c;  // with the unrounded colour of least error
    for (int k = 0; k < 3; ++k) ideal.color[k] = products[k] / products[3];
    // No other colour can win, even with the most bits that it is expected to save.
    const double gained = state_.change(c, products, -2.0) - state_.change(ideal, products, -2.0);
    if (c.cost - gained - kBitsOfColor * state_.settings.price >= best.cost) return;
    Symbols rounded{};
    rounded.context = c.symbols.context;
    if (!in_range(c.factor, ideal.color) || !quantise(state_.p, c.mean, c.factor, ideal.color, rounded)) return;
    for (int toward = 0; toward < 4; ++toward) {  // the rounded colour; then each component one step nearer to zero
      Symbols s = rounded;
      if (toward > 0) {
        int& part = toward == 1 ? s.y : toward == 2 ? s.a : s.b;
        if (part == 0) continue;
        part -= part > 0 ? 1 : -1;
        if (s.empty()) continue;
      }
      weigh(s, c, products, best);
    }
  }

  // Compares c, with the colour of s, with the best so far. Another colour may change the steps, and so the geometry:
  // then the products are computed again.
  void weigh(const Symbols& s, const Candidate& c, const float* products, Candidate& best) {
    if (s.y == c.symbols.y && s.a == c.symbols.a && s.b == c.symbols.b) return;
    Symbols same = c.symbols;
    same.y = s.y, same.a = s.a, same.b = s.b;
    const Steps before(c.symbols), after(same);
    Candidate found;
    if (same.size_class == s.size_class && before.exponent == after.exponent) {
      const Parts old_parts = parts_of(c.symbols, before), parts = parts_of(same, after);
      if (old_parts.x_bits == parts.x_bits && old_parts.y_bits == parts.y_bits) {
        found = state_.decoded(same);
        found.cost = cost(found, products);
        if (found.cost < best.cost) best = found;
        return;
      }
    }
    const Candidate colored = state_.decoded(same);
    if (!quantised(c.mean, c.factor, colored.color, same.context, found) || found.level != level_) return;
    float again[4];
    project(found, again);
    found.cost = cost(found, again);
    if (found.cost < best.cost) best = found;
  }

  // The spans of a Gaussian. If one of them lies outside the part, returns none and sets outside_.
  const std::vector<Span>& spans_of(const Footprint& f, const float* factor, int level) {
    spans_.clear();
    bool within = true;
    spans(f, factor, state_.reach, state_.reduced->grid(level), [&](const Span& s) {
      // The product of a coarse level's Gaussian extends two samples beyond its weights.
      const int beyond = level == 0 ? 0 : Patch::kMarginRows, column = s.strip * kTileWidth;
      within = within && column + s.first_lane - beyond >= part_.strip0 * kTileWidth &&
               column + s.last_lane + beyond < part_.strip1 * kTileWidth && s.first_row - beyond >= part_.row0 &&
               s.last_row + beyond < part_.row1;
      spans_.push_back(s);
    });
    if (!within) {
      outside_ = true;
      spans_.clear();
    }
    return spans_;
  }

  State& state_;
  const Part part_;
  bool outside_ = false;
  int level_ = 0;  // of the Gaussian being visited
  std::vector<Span> spans_;
  Patch patch_;
};

}  // namespace
}  // namespace sg
