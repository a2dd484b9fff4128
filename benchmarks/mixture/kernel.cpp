// Kernels of the trial: one body for the sum of Gaussians and for the mixture, so that both are fitted and coded alike.
//
//   sum       y = b + sum_i w_i c_i
//   mixture   y = (e b + sum_i a_i w_i c_i) / (e + sum_i a_i w_i)
//   w = exp(-|z|^2 / 2) - exp(-reach^2 / 2) where |z| < reach, z = L^-1 (x - mean), L = [l1 0; l2 l3]
//   log a = free - gamma log sqrt(l1 l3)
//
// Values of a kernel: mean (2), l1, l2, l3, free part of log a, colour (3).
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <vector>

namespace {

constexpr int kValues = 9;
constexpr float kFaint = 9e-4f, kNarrowest = 0.5f, kLn2 = 0.69314718f;

struct Scene {
  int width, height, count, mixture;
  float reach, gamma, log_e, b[3];
};

inline float fast_exp(float x) {  // relative error below 3e-6, for x in -80 .. 80
  x *= 1.44269504f;
  const float whole = std::floor(x), f = x - whole;
  const float r = 1 + f * (0.69314697f + f * (0.24022212f + f * (0.05550713f + f * (0.00967554f + f * 0.00132907f))));
  const int32_t bits = (static_cast<int32_t>(whole) + 127) << 23;
  float scale;
  std::memcpy(&scale, &bits, 4);
  return r * scale;
}

struct Kernel {
  float mx, my, i1, i3, slope, a, cut, reach, c[3], across, down;
  Kernel(const Scene& s, const float* p) {
    mx = p[0], my = p[1], i1 = 1 / p[2], i3 = 1 / p[4], slope = p[3] / p[2], reach = s.reach;
    a = s.mixture ? std::exp(p[5] - s.gamma * 0.5f * std::log(p[2] * p[4])) : 1.0f;
    cut = std::exp(-0.5f * reach * reach);
    std::copy_n(p + 6, 3, c);
    across = reach * p[2], down = reach * std::sqrt(p[3] * p[3] + p[4] * p[4]);
  }
  // Calls f(first pixel, count, u of the first, v of the first, step of v) for each row that it reaches.
  template <typename F>
  void rows(const Scene& s, F f, int every = 1) const {
    const int y0 = std::max(0, static_cast<int>(std::ceil(my - down - 0.5f)));
    const int y1 = std::min(s.height - 1, static_cast<int>(std::floor(my + down - 0.5f)));
    const float A = i1 * i1 + slope * slope * i3 * i3, B = slope * i3 * i3, C = i3 * i3;
    for (int y = y0; y <= y1; y += every) {
      const float dy = y + 0.5f - my, left = reach * reach - dy * dy * (C - B * B / A);
      if (left <= 0) continue;
      const float middle = mx + B * dy / A, half = std::sqrt(left / A);
      const int x0 = std::max(0, static_cast<int>(std::ceil(middle - half - 0.5f)));
      const int x1 = std::min(s.width - 1, static_cast<int>(std::floor(middle + half - 0.5f)));
      const float dx = x0 + 0.5f - mx;
      if (x1 >= x0) f(y * s.width + x0, x1 - x0 + 1, dx * i1, (dy - slope * dx) * i3, -slope * i3);
    }
  }
};

// Sums over a scene: sum of a w c, and of a w; background and e included. For the sum, the latter is 1.
struct Picture {
  int n;
  std::vector<float> num[3], den;
  explicit Picture(const Scene& s) : n(s.width * s.height), den(n, s.mixture ? std::exp(s.log_e) : 1.0f) {
    for (int j = 0; j < 3; ++j) num[j].assign(n, s.b[j] * den[0]);
  }
  template <bool mixture>
  void add_as(const Scene& s, const Kernel& k, float amplitude) {
    float *n0 = num[0].data(), *n1 = num[1].data(), *n2 = num[2].data(), *d = den.data();
    k.rows(s, [&](int at, int count, float u, float v, float dv) {
#pragma omp simd
      for (int i = 0; i < count; ++i) {
        const float uu = u + i * k.i1, vv = v + i * dv;
        const float w = amplitude * std::max(fast_exp(-0.5f * (uu * uu + vv * vv)) - k.cut, 0.0f);
        n0[at + i] += w * k.c[0], n1[at + i] += w * k.c[1], n2[at + i] += w * k.c[2];
        if (mixture) d[at + i] += w;
      }
    });
  }
  void add(const Scene& s, const Kernel& k, float sign = 1) {
    s.mixture ? add_as<true>(s, k, sign * k.a) : add_as<false>(s, k, sign);
  }
  void draw(const Scene& s, const float* p) {
    for (int i = 0; i < s.count; ++i) add(s, Kernel(s, p + kValues * i));
  }
};

// Error, summed; its gradient by values in each kernel's own frame (mean 2, factor 3, log a, colour 3), half the
// diagonal of its Gauss-Newton matrix (7: the colour's three are equal), and the same by log e and b.
double gradient(const Scene& s, const float* p, const float* target, float* by, float* bend, float* of_ground) {
  Picture pic(s);
  pic.draw(s, p);
  const int n = pic.n;
  std::vector<float> y[3], g[3], yg(n), inv(n);
  for (int j = 0; j < 3; ++j) y[j].resize(n), g[j].resize(n);
  double error = 0, ground[8] = {};
  const float e = std::exp(s.log_e);
  for (int i = 0; i < n; ++i) {
    inv[i] = 1 / pic.den[i];
    yg[i] = 0;
    for (int j = 0; j < 3; ++j) {
      y[j][i] = pic.num[j][i] * inv[i];
      const float r = y[j][i] - target[j * n + i];
      error += r * r;
      g[j][i] = 2 * r * inv[i];
      const float share = s.mixture ? e : 1.0f, f = (s.b[j] - y[j][i]) * e * inv[i];
      ground[1 + j] += share * g[j][i];
      ground[5 + j] += share * inv[i] * share * inv[i];
      ground[0] += s.mixture * f * 2 * r, ground[4] += s.mixture * f * f;
      yg[i] += s.mixture * y[j][i] * g[j][i];
    }
  }
  std::copy_n(ground, 8, of_ground);
  const float *y0 = y[0].data(), *y1 = y[1].data(), *y2 = y[2].data(), *in = inv.data(), *ygs = yg.data();
  const float *g0 = g[0].data(), *g1 = g[1].data(), *g2 = g[2].data(), own = s.mixture ? 1.0f : 0.0f;
  for (int index = 0; index < s.count; ++index) {
    const Kernel k(s, p + kValues * index);
    float t[9] = {}, h[7] = {};
    k.rows(s, [&](int at, int count, float u, float v, float dv) {
      float t0 = 0, t1 = 0, t2 = 0, t3 = 0, t4 = 0, t5 = 0, t6 = 0, t7 = 0, t8 = 0;
      float h0 = 0, h1 = 0, h2 = 0, h3 = 0, h4 = 0, h5 = 0, h6 = 0;
#pragma omp simd reduction(+ : t0, t1, t2, t3, t4, t5, t6, t7, t8, h0, h1, h2, h3, h4, h5, h6)
      for (int i = 0; i < count; ++i) {
        const int q = at + i;
        const float uu = u + i * k.i1, vv = v + i * dv;
        const float ex = fast_exp(-0.5f * (uu * uu + vv * vv)), w = k.a * std::max(ex - k.cut, 0.0f), E = k.a * ex;
        const float c0 = k.c[0] - own * y0[q], c1 = k.c[1] - own * y1[q], c2 = k.c[2] - own * y2[q];
        const float f = k.c[0] * g0[q] + k.c[1] * g1[q] + k.c[2] * g2[q] - ygs[q];
        const float far = (c0 * c0 + c1 * c1 + c2 * c2) * in[q] * in[q];
        const float Ef = E * f, Eh = E * E * far, u2 = uu * uu, v2 = vv * vv, uv = uu * vv;
        t0 += Ef * uu, t1 += Ef * vv, t2 += Ef * u2, t3 += Ef * uv, t4 += Ef * v2, t5 += w * f;
        t6 += w * g0[q], t7 += w * g1[q], t8 += w * g2[q];
        h0 += Eh * u2, h1 += Eh * v2, h2 += Eh * u2 * u2, h3 += Eh * uv * uv, h4 += Eh * v2 * v2;
        h5 += w * w * far, h6 += w * w * in[q] * in[q];
      }
      const float ts[9] = {t0, t1, t2, t3, t4, t5, t6, t7, t8}, hs[7] = {h0, h1, h2, h3, h4, h5, h6};
      for (int j = 0; j < 9; ++j) t[j] += ts[j];
      for (int j = 0; j < 7; ++j) h[j] += hs[j];
    });
    if (s.mixture) {  // the amplitude follows the scale
      const float half = 0.5f * s.gamma;
      t[2] -= half * t[5], t[4] -= half * t[5], h[2] += half * half * h[5], h[4] += half * half * h[5];
    }
    std::copy_n(t, 9, by + 9 * index);
    std::copy_n(h, 7, bend + 7 * index);
  }
  return error;
}

constexpr float kBasis[3][3] = {{0.57735f, 0.57735f, 0.57735f}, {0.70711f, 0, -0.70711f}, {0.40825f, -0.81650f, 0.40825f}};

// What earlier kernels, the larger ones, and the background show at a place: a prediction of the next colour.
void predict(const Scene& s, const float* p, int earlier, const float* at, float* out) {
  if (!s.mixture) { std::fill_n(out, 3, 0.0f); return; }
  float den = std::exp(s.log_e), num[3] = {den * s.b[0], den * s.b[1], den * s.b[2]};
  for (int i = 0; i < earlier; ++i) {
    const float* k = p + kValues * i;
    const float dx = at[0] - k[0], u = dx / k[2], v = (at[1] - k[1] - k[3] / k[2] * dx) / k[4];
    const float q = 0.5f * (u * u + v * v);
    if (q > 0.5f * s.reach * s.reach) continue;
    const float w = std::exp(k[5] - s.gamma * 0.5f * std::log(k[2] * k[4])) * fast_exp(-q);
    den += w;
    for (int j = 0; j < 3; ++j) num[j] += w * k[6 + j];
  }
  for (int j = 0; j < 3; ++j) out[j] = num[j] / den;
}

inline float sign(float x) { return static_cast<float>((x > 0) - (x < 0)); }

#include "coding.h"

}  // namespace

extern "C" {

struct Fit {
  float rate, price, quantum, beta1, beta2, newton, amplitude_rate, ground_rate;
  int steps, amplitudes;
};

void draw(const Scene* s, const float* p, float* out) {
  Picture pic(*s);
  pic.draw(*s, p);
  for (int i = 0; i < pic.n; ++i)
    for (int j = 0; j < 3; ++j) out[j * pic.n + i] = s->mixture ? pic.num[j][i] / pic.den[i] : pic.num[j][i];
}

double errors(const Scene* s, const float* p, const float* target, float* by, float* bend, float* ground) {
  return gradient(*s, p, target, by, bend, ground);
}

void predictions(const Scene* s, const float* p, float* out) {
  for (int i = 0; i < s->count; ++i) predict(*s, p, i, p + kValues * i, out + 3 * i);
}

// Steps of Adam in each kernel's own frame, none longer than `newton` steps of Gauss-Newton along its axis, down the
// gradient of error + price * bits. predicted [n, 3] stays as it is. moments [n, 9, 2] and [4, 2].
double fit(Scene* s, float* p, const float* target, const float* predicted, float* moments, float* ground_moments,
           int* ages, const Fit* f) {
  const int n = s->count;
  std::vector<float> by(9 * n + 9), bend(7 * n + 7);
  float ground[8];
  double error = 0;
  for (int step = 0; step < f->steps; ++step) {
    error = gradient(*s, p, target, by.data(), bend.data(), ground);
    const float rate = f->rate;
    for (int i = 0; i < n; ++i) {
      float *k = p + 9 * i, *g = &by[9 * i], *h = &bend[7 * i], *m = moments + 18 * i;
      if (f->price > 0) {
        const float inverse = std::sqrt(k[2] * k[4]) / f->quantum, scale = f->price / kLn2;
        float axis[3], square = 1e-12f;
        for (int a = 0; a < 3; ++a) {
          axis[a] = 0;
          for (int j = 0; j < 3; ++j) axis[a] += kBasis[a][j] * (k[6 + j] - predicted[3 * i + j]) * inverse;
          square += axis[a] * axis[a];
        }
        const float mm = std::sqrt(square), v = 0.5f * std::log(k[2] / k[4]), r = k[3] / k[4];
        const float d_v = scale / (1 + std::abs(v) * mm), d_r = scale / (2 + std::abs(r) * mm);
        const float d_m = d_v * std::abs(v) + d_r * std::abs(r) + 3 * scale / (1 + mm);
        float d_size = 0;
        for (int a = 0; a < 3; ++a) {
          const float d = sign(axis[a]) * scale / (1 + std::abs(axis[a])) + d_m * axis[a] / mm;
          d_size += d * axis[a];
          for (int j = 0; j < 3; ++j) g[6 + j] += d * inverse * kBasis[a][j];
        }
        const float by_v = sign(v) * d_v * mm, by_r = sign(r) * d_r * mm;  // s1: l1, l2; s2: l2 / l3; s3: l3
        g[2] += 0.5f * (d_size + by_v) + by_r * r, g[3] += by_r, g[4] += 0.5f * (d_size - by_v) - by_r * r;
      }
      const float area = k[2] * k[4];
      const float c1 = 1 - std::pow(f->beta1, ++ages[i]), c2 = 1 - std::pow(f->beta2, ages[i]);
      float move[9];
      for (int j = 0; j < 9; ++j) {
        m[2 * j] = f->beta1 * m[2 * j] + (1 - f->beta1) * g[j];
        m[2 * j + 1] = f->beta2 * m[2 * j + 1] + (1 - f->beta2) * g[j] * g[j];
        const float most = f->newton / (2 * (h[std::min(j, 6)] + (j < 6 ? kFaint * area : 1e-3f)));
        const float adam = (j == 5 ? f->amplitude_rate : 1.0f) * rate / (std::sqrt(m[2 * j + 1] / c2) + 1e-15f);
        move[j] = -std::min(adam, most) * m[2 * j] / c1;
        if (j == 5 && !f->amplitudes) move[j] = 0;
      }
      k[0] += k[2] * move[0];
      k[1] += k[3] * move[0] + k[4] * move[1];
      const float grow1 = std::exp(move[2]), grow3 = std::exp(move[4]);
      k[3] = k[3] * grow1 + k[4] * move[3];
      k[2] = std::clamp(k[2] * grow1, kNarrowest, 400.0f), k[4] = std::clamp(k[4] * grow3, kNarrowest, 400.0f);
      k[3] = std::clamp(k[3], -30 * k[4], 30 * k[4]);
      k[5] = std::clamp(k[5] + move[5], -8.0f, 8.0f);
      const float size = std::sqrt(k[2] * k[4]), far = std::min(2 * size, 0.5f * s->reach * size);
      k[0] = std::clamp(k[0], -far, s->width + far), k[1] = std::clamp(k[1], -far, s->height + far);
      for (int j = 6; j < 9; ++j) k[j] = std::clamp(k[j] + move[j], s->mixture ? -1.0f : -4.0f, s->mixture ? 2.0f : 4.0f);
    }
    ++ages[n];
    const float c1 = 1 - std::pow(f->beta1, ages[n]), c2 = 1 - std::pow(f->beta2, ages[n]);
    for (int j = s->mixture ? 0 : 1; j < 4; ++j) {
      float* m = ground_moments + 2 * j;
      m[0] = f->beta1 * m[0] + (1 - f->beta1) * ground[j];
      m[1] = f->beta2 * m[1] + (1 - f->beta2) * ground[j] * ground[j];
      const float most = f->newton / (2 * ground[4 + j] + 1e-3f), adam = f->ground_rate * rate / (std::sqrt(m[1] / c2) + 1e-15f);
      const float move = -std::min(adam, most) * m[0] / c1;
      if (j == 0) s->log_e = std::clamp(s->log_e + move, -14.0f, 3.0f);
      else s->b[j - 1] = std::clamp(s->b[j - 1] + move, -0.5f, 1.5f);
    }
  }
  return error;
}

// How much the error rises without each kernel.
void losses(const Scene* s, const float* p, const float* target, float* out) {
  Picture pic(*s);
  pic.draw(*s, p);
  const int n = pic.n;
  for (int index = 0; index < s->count; ++index) {
    const Kernel k(*s, p + kValues * index);
    double sum = 0;
    k.rows(*s, [&](int at, int count, float u, float v, float dv) {
      float row = 0;
      for (int i = 0; i < count; ++i) {
        const int q = at + i;
        const float uu = u + i * k.i1, vv = v + i * dv;
        const float w = k.a * std::max(fast_exp(-0.5f * (uu * uu + vv * vv)) - k.cut, 0.0f);
        const float now = 1 / pic.den[q], then = s->mixture ? 1 / std::max(pic.den[q] - w, 1e-12f) : now;
        for (int j = 0; j < 3; ++j) {
          const float a = pic.num[j][q] * now - target[j * n + q], b = (pic.num[j][q] - w * k.c[j]) * then - target[j * n + q];
          row += b * b - a * a;
        }
      }
      sum += row;
    });
    out[index] = static_cast<float>(sum);
  }
}

// The gain of one more round kernel at places of a grid, with its best colour: exact for both models. For a mixture
// each of `shares` is tried: the new one's part of the weight at its centre. out [columns * rows, 5]: gain, a, colour.
void gains(const Scene* s, const float* p, const float* target, float scale, int stride, const float* shares, int tried,
           const uint8_t* places, float* out) {
  Picture pic(*s);
  pic.draw(*s, p);
  const int n = pic.n, columns = s->width / stride, rows = s->height / stride, every = std::max(1, static_cast<int>(scale / 1.6f));
  for (int row = 0; row < rows; ++row)
    for (int column = 0; column < columns; ++column, out += 5) {
      out[0] = 0;
      if (!places[row * columns + column]) continue;
      float k9[9] = {column * stride + 0.5f * stride, row * stride + 0.5f * stride, scale, 0, scale, 0, 0, 0, 0};
      Kernel k(*s, k9);
      const int middle = static_cast<int>(k.my) * s->width + static_cast<int>(k.mx);
      for (int j = 0; j < (s->mixture ? tried : 1); ++j) {
        const float a = s->mixture ? pic.den[middle] * shares[j] / (1 - shares[j]) : 1.0f;
        double P = 0, G = 1e-9, Q0 = 0, Q1 = 0, Q2 = 0;
        k.rows(*s, [&](int at, int count, float u, float v, float dv) {
          float sp = 0, sg = 0, s0 = 0, s1 = 0, s2 = 0;
          const float *t0 = target + at, *t1 = t0 + n, *t2 = t1 + n, *d = &pic.den[at];
          const float *n0 = &pic.num[0][at], *n1 = &pic.num[1][at], *n2 = &pic.num[2][at];
          const float more = s->mixture ? 1.0f : 0.0f;
#pragma omp simd reduction(+ : sp, sg, s0, s1, s2)
          for (int i = 0; i < count; ++i) {
            const float uu = u + i * k.i1, vv = v + i * dv;
            const float w = a * std::max(fast_exp(-0.5f * (uu * uu + vv * vv)) - k.cut, 0.0f);
            const float now = 1 / d[i], then = 1 / (d[i] + more * w), g = w * then;
            const float r0 = t0[i] - n0[i] * then, r1 = t1[i] - n1[i] * then, r2 = t2[i] - n2[i] * then;
            const float q0 = t0[i] - n0[i] * now, q1 = t1[i] - n1[i] * now, q2 = t2[i] - n2[i] * now;
            sp += q0 * q0 + q1 * q1 + q2 * q2 - r0 * r0 - r1 * r1 - r2 * r2;
            sg += g * g, s0 += g * r0, s1 += g * r1, s2 += g * r2;
          }
          P += sp, G += sg, Q0 += s0, Q1 += s1, Q2 += s2;
        }, every);
        const double gain = every * (P + (Q0 * Q0 + Q1 * Q1 + Q2 * Q2) / G);
        if (gain > out[0]) {
          out[0] = static_cast<float>(gain), out[1] = a;
          out[2] = static_cast<float>(Q0 / G), out[3] = static_cast<float>(Q1 / G), out[4] = static_cast<float>(Q2 / G);
        }
      }
    }
}

// Chooses candidates [n, 3] (x, y, scale), best first, of which none lies within another's reach. Returns how many.
int apart(const float* places, int n, int most, int* chosen) {
  int count = 0;
  for (int i = 0; i < n && count < most; ++i) {
    const float* a = places + 3 * i;
    bool free = true;
    for (int j = 0; j < count && free; ++j) {
      const float *b = places + 3 * chosen[j], dx = a[0] - b[0], dy = a[1] - b[1], near = 1.2f * (a[2] + b[2]);
      free = dx * dx + dy * dy > near * near;
    }
    if (free) chosen[count++] = i;
  }
  return count;
}

// Rounds kernels, refines the integers, and counts their bits. bend [n, 7]: from errors(). Values go back to p, integers
// to ints; *count is how many are left. counts: those of the models at the end. Returns the bits.
double refine(const Scene* s, float* p, const float* bend, const float* target, const Coding* q, const float* prior,
              int* count, int32_t* ints, float* counts, double* parts) {
  std::vector<Ints> all;
  std::vector<float> colors;
  for (int i = 0; i < s->count; ++i, p += kValues, bend += 7) {
    Ints n{};
    const float size = 2 * std::log2(std::sqrt(p[2] * p[4])), fine = std::sqrt((bend[0] + bend[1]) / 2 / 3.14159f) * q->place_step / q->quantum;
    n.h = std::clamp(static_cast<int>(std::lround(std::log2(fine + 1e-6f))), 0, kMaxFine - 1);
    n.k = std::clamp(static_cast<int>(std::floor(size)), kFirstClass, kFirstClass + kClasses - 1);
    n.u = std::clamp(static_cast<int>((size - n.k) * (1 << bits_of_size(n.h))), 0, (1 << bits_of_size(n.h)) - 1);
    const float step = q->shape_step * std::ldexp(1.0f, -n.h);
    n.v = static_cast<int>(std::lround(0.5f * std::log(p[2] / p[4]) / step));
    n.r = static_cast<int>(std::lround(p[3] / p[4] / (2 * step)));
    n.A = q->amplitudes ? std::clamp(static_cast<int>(std::lround(p[5] / q->amplitude_step)), -9, 9) : 0;
    float out[kValues];
    Places at;
    snap(*q, n, p[0], p[1]);
    if (decode(*q, n, out, at)) all.push_back(n), colors.insert(colors.end(), p + 6, p + 9);
  }
  p -= kValues * s->count;
  Search search(*s, *q, prior, target, all, colors);
  const double bits = search.sweep_all();
  *count = static_cast<int>(search.all_.size());
  std::copy(search.p_.begin(), search.p_.end(), p);
  std::memcpy(ints, search.all_.data(), sizeof(Ints) * search.all_.size());
  std::memcpy(counts, search.counts_, sizeof search.counts_);
  std::copy_n(search.parts_, 5, parts);
  return bits;
}

}  // extern "C"
