// Integers of a kernel, their bits by adaptive models, and the search over them: the same for the sum and the mixture.
//
// A kernel has a class k of size 2^(k/2) and, in it, u; v and r of shape; h, how fine all this is; a place (X, Y) in the
// class's cells; the amplitude A; and a colour in steps as fine as its class asks. Larger kernels come first. A
// colour is the difference from what earlier ones show at its place, which is nothing for a sum. Cells of a
// class are a set. Code lengths are those that an exact arithmetic coder approaches.
#pragma once

struct Ints {
  int32_t k, u, v, r, h, X, Y, A, c[3];
};
struct Coding {
  float quantum, place_step, shape_step, amplitude_step, price, color_step;
  int amplitudes, sweeps;
};
constexpr int kSymbols = 20, kContexts = 80, kFirstClass = -4, kClasses = 33, kMaxFine = 10;
constexpr int kOfFine = 0, kOfY = 10, kOfA = 11, kOfB = 15, kOfSigns = 19, kOfV = 27, kOfR = 38, kOfShapeSigns = 49,
              kOfAmplitude = 53;
constexpr float kPrior = 12;

inline int sized(int x) { return x < 3 ? x : x < 6 ? 2 : 3; }
inline int magnitude(int x) { return x < 4 ? x : 2 * (31 - __builtin_clz(x)) + ((x >> (30 - __builtin_clz(x))) & 1); }
inline int rest(int x) { return x < 4 ? 0 : (31 - __builtin_clz(x)) - 1; }
inline int bits_of_size(int h) { return std::max(h - 1, 0); }
inline int cell_of(int k) { return std::max(0, (k + 1) >> 1); }

inline float color_step(const Coding& q, int k) { return q.quantum * q.color_step * std::exp2(-0.5f * k); }

struct Places { int g, px, py; };

// The colour that is so far from a prediction.
inline void paint(const Coding& q, const Ints& n, const float* axes, float* color) {
  const float step = color_step(q, n.k);
  for (int j = 0; j < 3; ++j) {
    color[j] = 0;
    for (int i = 0; i < 3; ++i) color[j] += kBasis[i][j] * (axes[i] + n.c[i] * step);
  }
}

// From integers to values but the colour; false if they are out of range.
inline bool decode(const Coding& q, const Ints& n, float* p, Places& at) {
  const float fine = std::ldexp(1.0f, -n.h);
  const float size = std::exp2(0.5f * (n.k + (n.u + 0.5f) / (1 << bits_of_size(n.h))));
  const float V = n.v * q.shape_step * fine, rho = n.r * 2 * q.shape_step * fine;
  p[2] = size * std::exp(V), p[4] = size * std::exp(-V), p[3] = rho * p[4];
  at.g = cell_of(n.k);
  const float cell = std::ldexp(1.0f, at.g), step = q.place_step * fine;
  at.px = std::clamp(static_cast<int>(std::lround(std::log2(cell * std::sqrt(1 + rho * rho) / (p[2] * step)))), 0, 16);
  at.py = std::clamp(static_cast<int>(std::lround(std::log2(cell / (p[4] * step)))), 0, 16);
  p[0] = (n.X + 0.5f) * std::ldexp(1.0f, at.g - at.px) - 2 * cell;
  p[1] = (n.Y + 0.5f) * std::ldexp(1.0f, at.g - at.py) - 2 * cell;
  p[5] = n.A * q.amplitude_step;
  return n.k >= kFirstClass && n.k < kFirstClass + kClasses && n.h >= 0 && n.h < kMaxFine && std::abs(n.A) <= 9 &&
         p[2] > 0.3f && p[4] > 0.3f && std::abs(rho) < 40 && n.X >= 0 && n.Y >= 0;
}
// Sets X and Y to those next to a place.
inline void snap(const Coding& q, Ints& n, float x, float y) {
  float p[kValues];
  Places at;
  decode(q, n, p, at);
  const float cell = std::ldexp(1.0f, at.g);
  n.X = std::max(0, static_cast<int>(std::floor((x + 2 * cell) / std::ldexp(1.0f, at.g - at.px))));
  n.Y = std::max(0, static_cast<int>(std::floor((y + 2 * cell) / std::ldexp(1.0f, at.g - at.py))));
}

// Calls f(context, symbol) for each symbol of a kernel but its cell; returns its raw bits, the place's within the cell
// among them.
template <typename F>
int symbols(const Coding& q, const Ints& n, const Places& at, F f) {
  const int* d = n.c;
  const int y = std::abs(d[0]), a = std::abs(d[1]), b = std::abs(d[2]), v = std::abs(n.v), r = std::abs(n.r);
  const int S = y * y + a * a + b * b, near = S == 0 ? 0 : std::min(1 + (33 - __builtin_clz(S)) / 2 - 1, 9);
  f(kOfY, magnitude(y));
  f(kOfA + sized(y), magnitude(a));
  f(kOfB + sized(a), magnitude(b));
  if (S) f(kOfSigns + 4 * (y > 0) + 2 * (a > 0) + (b > 0), 4 * (d[0] < 0) + 2 * (d[1] < 0) + (d[2] < 0));
  f(kOfFine + near, n.h);
  f(kOfV + n.h, magnitude(v));
  f(kOfR + n.h, magnitude(r));
  if (v + r) f(kOfShapeSigns + 2 * (v > 0) + (r > 0), 2 * (n.v < 0) + (n.r < 0));
  if (q.amplitudes) f(kOfAmplitude + near, n.A + 9);
  return rest(y) + rest(a) + rest(b) + rest(v) + rest(r) + bits_of_size(n.h) + at.px + at.py;
}

inline uint64_t morton(uint32_t x, uint32_t y) {
  uint64_t z = 0;
  for (int i = 0; i < 20; ++i) z |= static_cast<uint64_t>((x >> i) & 1) << (2 * i) | static_cast<uint64_t>((y >> i) & 1) << (2 * i + 1);
  return z;
}

class Search {
 public:
  Search(const Scene& s, const Coding& q, const float* prior, const float* target, std::vector<Ints> all, std::vector<float> colors)
      : all_(std::move(all)), colors_(std::move(colors)), s_(s), q_(q), prior_(prior), target_(target) { arrange(); }
  std::vector<Ints> all_;
  std::vector<float> colors_, p_;
  float counts_[kContexts][kSymbols];
  double parts_[5];  // bits of cells, raw bits, colours, shapes with h, amplitudes

  double sweep_all() {
    double bits = count();
    for (int i = 0; i < q_.sweeps; ++i) sweep(), bits = count();
    return bits;
  }

 private:
  double cells(int k) const {
    const int g = cell_of(k);
    return double((s_.width >> g) + 5) * ((s_.height >> g) + 5);
  }
  // Sorts kernels as they are coded, and decodes them, as near to their colours as their predictions allow.
  void arrange() {
    std::vector<std::pair<std::pair<int, uint64_t>, size_t>> keyed;
    float p[kValues];
    Places at;
    for (size_t i = 0; i < all_.size(); ++i) {
      decode(q_, all_[i], p, at);
      keyed.push_back({{-all_[i].k, morton(all_[i].X >> at.px, all_[i].Y >> at.py)}, i});
    }
    std::stable_sort(keyed.begin(), keyed.end());
    const std::vector<Ints> all = all_;
    const std::vector<float> colors = colors_;
    s_.count = static_cast<int>(all.size());
    p_.resize(kValues * all.size());
    for (int i = 0; i < s_.count; ++i) {
      Ints& n = all_[i] = all[keyed[i].second];
      float *here = &p_[kValues * i], *color = &colors_[3 * i], axes[3];
      std::copy_n(&colors[3 * keyed[i].second], 3, color);
      decode(q_, n, here, at);
      predicted(i, here, axes);
      for (int a = 0; a < 3; ++a)
        n.c[a] = static_cast<int>(std::lround((kBasis[a][0] * color[0] + kBasis[a][1] * color[1] + kBasis[a][2] * color[2] - axes[a]) / color_step(q_, n.k)));
      paint(q_, n, axes, here + 6);
      std::copy_n(here + 6, 3, color);
    }
  }
  void predicted(int i, const float* place, float* axes) const {
    float rgb[3];
    predict(s_, p_.data(), i, place, rgb);
    for (int a = 0; a < 3; ++a) axes[a] = kBasis[a][0] * rgb[0] + kBasis[a][1] * rgb[1] + kBasis[a][2] * rgb[2];
  }
  // Bits of all, by models that adapt; sets counts and costs.
  double count() {
    arrange();
    std::memcpy(counts_, prior_, sizeof counts_);
    std::fill_n(number_, kClasses, 0);
    std::fill_n(parts_, 5, 0.0);
    for (int i = 0; i < s_.count; ++i) {
      const Ints& n = all_[i];
      ++number_[n.k - kFirstClass];
      float p[kValues];
      Places at;
      decode(q_, n, p, at);
      parts_[1] += symbols(q_, n, at, [&](int context, int symbol) {
        float* c = counts_[context];
        float total = 0;
        for (int j = 0; j < kSymbols; ++j) total += c[j];
        parts_[context >= kOfAmplitude ? 4 : context >= kOfV || context < kOfY ? 3 : 2] -= std::log2(c[symbol] / total);
        c[symbol] += 1;
      });
    }
    const auto choose = [](double m, double n) { return (std::lgamma(m + n) - std::lgamma(m) - std::lgamma(n + 1)) / kLn2; };
    for (int k = 0; k < kClasses; ++k) {
      const double n = number_[k];
      if (n > 0) parts_[0] += choose(cells(k + kFirstClass), n) + 2 * std::floor(std::log2(n + 1)) + 1;
    }
    for (int k = 0; k < kContexts; ++k) {
      float total = 0;
      for (float c : counts_[k]) total += c;
      for (int j = 0; j < kSymbols; ++j) cost_[k][j] = -std::log2(counts_[k][j] / total);
    }
    return parts_[0] + parts_[1] + parts_[2] + parts_[3] + parts_[4] + 12;
  }

  struct Tried {
    Ints n;
    float p[kValues];
    double cost;
  };
  // A candidate with its best colours. cost: by how much it changes error + price * bits, against no kernel.
  bool look(int i, Tried& t) const {
    Places at;
    if (!decode(q_, t.n, t.p, at)) return false;
    const Kernel k(s_, t.p);
    double P = 0, G = 1e-9, Q[3] = {};
    const Picture& pic = *pic_;
    const int n = pic.n;
    k.rows(s_, [&](int at, int count, float u, float v, float dv) {
      float sp = 0, sg = 0, s0 = 0, s1 = 0, s2 = 0;
      const float *t0 = target_ + at, *t1 = t0 + n, *t2 = t1 + n, *d = &pic.den[at];
      const float *n0 = &pic.num[0][at], *n1 = &pic.num[1][at], *n2 = &pic.num[2][at], more = s_.mixture ? 1.0f : 0.0f;
#pragma omp simd reduction(+ : sp, sg, s0, s1, s2)
      for (int i = 0; i < count; ++i) {
        const float uu = u + i * k.i1, vv = v + i * dv;
        const float w = k.a * std::max(fast_exp(-0.5f * (uu * uu + vv * vv)) - k.cut, 0.0f);
        const float now = 1 / d[i], then = 1 / (d[i] + more * w), g = w * then;
        const float r0 = t0[i] - n0[i] * then, r1 = t1[i] - n1[i] * then, r2 = t2[i] - n2[i] * then;
        const float q0 = t0[i] - n0[i] * now, q1 = t1[i] - n1[i] * now, q2 = t2[i] - n2[i] * now;
        sp += r0 * r0 + r1 * r1 + r2 * r2 - q0 * q0 - q1 * q1 - q2 * q2;
        sg += g * g, s0 += g * r0, s1 += g * r1, s2 += g * r2;
      }
      P += sp, G += sg, Q[0] += s0, Q[1] += s1, Q[2] += s2;
    });
    float axes[3];
    predicted(i, t.p, axes);
    const float step = color_step(q_, t.n.k);
    int before = 0;
    t.cost = P;
    for (int j = 0; j < 3; ++j) {
      const double q = kBasis[j][0] * Q[0] + kBasis[j][1] * Q[1] + kBasis[j][2] * Q[2];
      const int best = static_cast<int>(std::lround(std::clamp((q / G - axes[j]) / step, -700.0, 700.0)));
      const float* cost = cost_[j == 0 ? kOfY : j == 1 ? kOfA + sized(before) : kOfB + sized(before)];
      double least = 1e30, gained = 0;
      for (const int c : {best, best > 0 ? best - 1 : best + 1, 0}) {
        const double x = axes[j] + c * static_cast<double>(step), error = G * x * x - 2 * x * q;
        const double with_bits = error + q_.price * (cost[magnitude(std::abs(c))] + rest(std::abs(c)) + (c ? 1.5 : 0));
        if (with_bits < least) least = with_bits, gained = error, t.n.c[j] = c;
      }
      before = std::abs(t.n.c[j]);
      t.cost += gained;
    }
    paint(q_, t.n, axes, t.p + 6);
    double bits = 0;
    const int raw = symbols(q_, t.n, at, [&](int context, int symbol) { bits += cost_[context][symbol]; });
    bits += raw;
    const double n_k = number_[t.n.k - kFirstClass], m_k = cells(t.n.k);
    t.cost += q_.price * (bits + std::log2((m_k + n_k) / (n_k + 1)));
    return true;
  }

  void sweep() {
    Picture pic(s_);
    pic.draw(s_, p_.data());
    pic_ = &pic;
    std::vector<char> gone(all_.size());
    for (size_t i = 0; i < all_.size(); ++i) {
      float* p = &p_[kValues * i];
      pic.add(s_, Kernel(s_, p), -1);
      Tried best{all_[i], {}, 0};
      bool some = look(static_cast<int>(i), best);
      if (!some) best.cost = 1e30;
      const auto attempt = [&](auto change, bool moves) {
        Tried t = best;
        const float x = best.p[0], y = best.p[1];
        change(t.n);
        if (moves) snap(q_, t.n, x, y);
        if (look(static_cast<int>(i), t) && t.cost < best.cost) { best = t; return true; }
        return false;
      };
      for (const int by : {1, -1}) {
        attempt([&](Ints& n) { n.X += by; }, false);
        attempt([&](Ints& n) { n.Y += by; }, false);
        attempt([&](Ints& n) {
          const int b = bits_of_size(n.h), all = (n.k << b) + n.u + by;
          n.k = all >> b, n.u = all & ((1 << b) - 1);
        }, true);
        attempt([&](Ints& n) { n.v += by; }, true);
        attempt([&](Ints& n) { n.r += by; }, true);
        if (q_.amplitudes) attempt([&](Ints& n) { n.A += by; }, false);
        attempt([&](Ints& n) {
          const int b = bits_of_size(n.h), to = bits_of_size(n.h += by);
          n.u = to > b ? 2 * n.u + 1 : to < b ? n.u >> 1 : n.u;
          n.v = static_cast<int>(std::lround(by > 0 ? n.v * 2.0 : n.v / 2.0));
          n.r = static_cast<int>(std::lround(by > 0 ? n.r * 2.0 : n.r / 2.0));
        }, true);
      }
      if (best.cost >= 0) { gone[i] = 1; p[5] = -60; continue; }
      all_[i] = best.n;
      std::copy_n(best.p, kValues, p);
      pic.add(s_, Kernel(s_, p));
    }
    std::vector<Ints> left;
    for (size_t i = 0; i < all_.size(); ++i)
      if (!gone[i]) std::copy_n(&p_[kValues * i + 6], 3, &colors_[3 * left.size()]), left.push_back(all_[i]);
    all_ = left;
  }

  Scene s_;
  const Coding q_;
  const float *prior_, *target_;
  float cost_[kContexts][kSymbols];
  int number_[kClasses];
  Picture* pic_ = nullptr;
};
