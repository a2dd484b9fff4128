// Rounding Gaussians one by one leaves what their errors have in common, because they overlap. Here each in turn sees the
// picture that is left for it, and takes the best of: its integers one up or one down, each with the colour that is
// best then; none at all.
//
// With e the picture left, w the weights of a candidate and c its colour, the error is |e|^2 - 2 c <w, e> + |c|^2 <w, w>:
// four sums over its pixels tell it for every colour.
#include "rd_refine.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstring>

#include "kernels.h"
#include "rd_models.h"

namespace sg {
namespace {

constexpr double kPositionBits = 8.0;  // of a Gaussian's cell, about: what leaving it out saves beside its own bits

constexpr double kConverged = 0.02;  // part of the Gaussians that a last sweep changes
constexpr int kSweepsAfterDrops = 2;   // those that stay take over what the others did
constexpr size_t kPatience = 64;     // Gaussians between two looks at the clock
using Clock = std::chrono::steady_clock;

// A coder that only counts, by models that stay as they are.
struct BitCounter {
  static constexpr bool kDecodes = false;
  double bits = 0;
  int symbol(const Model& model, int symbol) {
    bits += kProbabilityBits - std::log2(static_cast<float>(model.edge(symbol + 1) - model.edge(symbol)));
    return symbol;
  }
  uint32_t raw(uint32_t value, int count) {
    bits += count;
    return value;
  }
};

struct Candidate {
  Symbols symbols;
  float mean[2], factor[3], color[3];
  double cost;  // squared error and price, against none at all
};

class Refinement {
 public:
  Refinement(const RdParameters& p, std::vector<Symbols> all, const float* target, const RefineSettings& settings)
      : p_(p), settings_(settings), floor_(exp_minus(settings.cutoff)), reach_(std::sqrt(2.0f * settings.cutoff)),
        all_(std::move(all)) {
    const int64_t strips = (p.width + kTileWidth - 1) / kTileWidth;
    values_.assign(strips * p.height * 3 * kTileWidth, 0.0f);
    left_ = {values_.data(), p.width, p.height};
    for (int k = 0; k < 3; ++k)
      for (int row = 0; row < p.height; ++row)
        for (int x = 0; x < p.width; ++x)
          left_.row(x / kTileWidth, row)[k * kTileWidth + x % kTileWidth] = target[(static_cast<int64_t>(k) * p.height + row) * p.width + x];
    for (const Symbols& s : all_) add(decoded(s), -1.0f);
  }

  std::vector<uint8_t> run() {
    const std::chrono::duration<double> seconds(std::min(settings_.seconds, 1e6));
    until_ = Clock::now() + std::chrono::duration_cast<Clock::duration>(seconds);
    std::vector<uint8_t> payload = swept(settings_.sweeps);
    for (int sweeps = kSweepsAfterDrops; payload.size() > settings_.max_bytes && !all_.empty(); --sweeps) {
      while (payload.size() > settings_.max_bytes && !all_.empty()) {
        drop_least(payload.size());
        payload = encode();
      }
      if (sweeps > 0) payload = swept(1);
    }
    return payload;
  }

 private:
  // The payload after so many sweeps, at most, over all Gaussians.
  std::vector<uint8_t> swept(int sweeps) {
    std::vector<uint8_t> payload = encode();
    for (int sweep = 0; sweep < sweeps && Clock::now() < until_; ++sweep) {
      size_t changed = 0;
      for (size_t i = 0; i < all_.size() && (i % kPatience != 0 || Clock::now() < until_); ++i) changed += visit(all_[i]);
      payload = encode();
      if (changed < all_.size() * kConverged) break;
    }
    return payload;
  }

  std::vector<uint8_t> encode() {
    erase_empty(all_);
    models_ = Models();
    return encode_symbols(p_, all_, models_);
  }

  Candidate decoded(const Symbols& s) const {
    Candidate c{s, {}, {}, {}, 0};
    dequantise(p_, s, Geometry(s, Steps(s)), c.mean, c.factor, c.color);
    return c;
  }

  bool quantised(const float* mean, const float* factor, const float* color, Candidate& c) const {
    Symbols s{};
    if (!quantise(p_, mean, factor, color, s)) return false;
    c = decoded(s);
    return true;
  }

  const std::vector<Span>& spans_of(const Footprint& f, const float* factor) {
    spans_.clear();
    spans(f, factor, reach_, p_.width, p_.height, [&](int strip, int row0, int row1) { spans_.push_back({strip, row0, row1}); });
    return spans_;
  }

  void add(const Candidate& c, float sign) {
    const Footprint f(c.mean, c.factor);
    const std::vector<Span>& spans = spans_of(f, c.factor);
    const float color[3] = {sign * c.color[0], sign * c.color[1], sign * c.color[2]};
    fit_kernels(best_isa()).add(f, floor_, spans.data(), static_cast<int>(spans.size()), color, left_);
  }

  void project(const Candidate& c, float* products) {
    const Footprint f(c.mean, c.factor);
    const std::vector<Span>& spans = spans_of(f, c.factor);
    fit_kernels(best_isa()).project(f, floor_, spans.data(), static_cast<int>(spans.size()), left_, products);
  }

  double bits(const Symbols& s) {
    BitCounter counter;
    Symbols copy = s;
    models_.gaussian(counter, p_, copy);
    return counter.bits + kPositionBits;
  }

  double cost(const Candidate& c, const float* products) {
    double error = 0;
    for (int k = 0; k < 3; ++k) error += c.color[k] * (static_cast<double>(c.color[k]) * products[3] - 2.0 * products[k]);
    return error + settings_.price * bits(c.symbols);
  }

  // c with the colour that is best for its geometry; where the steps, and so the geometry, change with it, they are
  // weighed again.
  void consider(Candidate c, Candidate& best) {
    float products[4];
    project(c, products);
    if (products[3] <= 0.0f) return;
    c.cost = cost(c, products);
    if (c.cost < best.cost) best = c;
    const float color[3] = {products[0] / products[3], products[1] / products[3], products[2] / products[3]};
    Symbols rounded{};
    if (!quantise(p_, c.mean, c.factor, color, rounded)) return;
    for (int toward = 0; toward < 4; ++toward) {  // as rounded; then one part a step nearer to zero
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

  // The colour of s with the geometry of c.
  void weigh(const Symbols& s, const Candidate& c, const float* products, Candidate& best) {
    if (s.y == c.symbols.y && s.a == c.symbols.a && s.b == c.symbols.b) return;
    Symbols same = c.symbols;
    same.y = s.y, same.a = s.a, same.b = s.b;
    const Steps before(c.symbols), after(same);
    Candidate found;
    if (same.size_class == s.size_class && before.exponent == after.exponent) {
      const Geometry old_geometry(c.symbols, before), geometry(same, after);
      if (old_geometry.x_bits == geometry.x_bits && old_geometry.y_bits == geometry.y_bits) {
        found = decoded(same);
        found.cost = cost(found, products);
        if (found.cost < best.cost) best = found;
        return;
      }
    }
    const Candidate colored = decoded(same);
    if (!quantised(c.mean, c.factor, colored.color, found)) return;
    float again[4];
    project(found, again);
    found.cost = cost(found, again);
    if (found.cost < best.cost) best = found;
  }

  bool visit(Symbols& s) {
    const Candidate now = decoded(s);
    add(now, 1.0f);
    Candidate best{};  // none at all
    best.cost = 0;
    consider(now, best);
    const Steps steps(s);
    const Geometry g(s, steps);
    for (int sign = -1; sign <= 1; sign += 2) {
      // u through the floats, because it may lead to another class
      const float grow = std::exp(static_cast<float>(sign * 0.34657359 * Steps::power(-steps.u_bits())));
      const float grown[3] = {now.factor[0] * grow, now.factor[1] * grow, now.factor[2] * grow};
      Candidate c;
      if (quantised(now.mean, grown, now.color, c)) consider(c, best);
      for (int which = 0; which < 4; ++which) {
        Symbols moved = s;
        if (which == 0) {
          moved.v += sign;
        } else if (which == 1) {
          if (p_.upright) continue;
          moved.r += sign;
        } else if (which == 2) {
          moved.px += sign;
        } else {
          moved.py += sign;
        }
        if (std::abs(moved.v) > kMaxShape || std::abs(moved.r) > kMaxShape || std::abs(moved.v) * steps.v() > kMaxAspect) continue;
        if (moved.px >> g.x_bits || moved.py >> g.y_bits) continue;
        c = decoded(moved);
        // With another shape the place keeps its value, whatever the parts of the cell are now.
        if (which < 2 && !quantised(now.mean, c.factor, c.color, c)) continue;
        consider(c, best);
      }
    }
    const bool changed = std::memcmp(&best.symbols, &s, sizeof s) != 0;
    s = best.symbols;
    if (!s.empty()) add(best, -1.0f);
    return changed;
  }

  // Leaves out Gaussians, those first that gain least error for each bit, for a part of what is too much: their bits are
  // estimates, and each leaves more for its neighbours to do.
  void drop_least(size_t bytes) {
    std::vector<std::pair<double, size_t>> order;
    std::vector<double> sizes;
    for (size_t i = 0; i < all_.size(); ++i) {
      const Candidate c = decoded(all_[i]);
      float products[4];
      project(c, products);
      double loss = 0;  // what is left grows by the Gaussian itself
      for (int k = 0; k < 3; ++k) loss += c.color[k] * (static_cast<double>(c.color[k]) * products[3] + 2.0 * products[k]);
      sizes.push_back(bits(c.symbols));
      order.emplace_back(loss / sizes.back(), i);
    }
    std::sort(order.begin(), order.end());
    double excess = 0.6 * 8.0 * static_cast<double>(bytes - settings_.max_bytes);
    for (size_t k = 0; k < order.size() && (k == 0 || excess > 0); ++k) {
      Symbols& s = all_[order[k].second];
      add(decoded(s), 1.0f);
      excess -= sizes[order[k].second];
      s.y = s.a = s.b = 0;
    }
  }

  const RdParameters& p_;
  const RefineSettings& settings_;
  const float floor_, reach_;
  std::vector<Symbols> all_;
  std::vector<float> values_;
  Strips left_;  // of the target, without all Gaussians
  std::vector<Span> spans_;
  Models models_;
  Clock::time_point until_;
};

}  // namespace

std::vector<uint8_t> rd_refine(const RdParameters& p, const float* means, const float* factors, const float* colors, int n,
                               const float* target, const RefineSettings& settings) {
  return Refinement(p, quantised(p, means, factors, colors, n), target, settings).run();
}

}  // namespace sg
