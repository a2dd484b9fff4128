#include "texture/texture.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "core/constants.h"
#include "core/errors.h"
#include "core/isa.h"
#include "core/simd.h"

namespace sg {
namespace {

// Factor on the strength of an octave that is drawn at level 0 of a reduced view, where it is not blurred by enlarging
// and also replaces the finer octave.
constexpr float kUnenlarged = 0.75f;

// The noise, plus 128: a periodic table, in words of four rows. Rows are longer than the period, for vectors that reach
// beyond it.
constexpr int kSide = 256, kBeyond = kTileWidth;
constexpr float kMiddle = 128.0f;
struct Noise {
  uint32_t words[kSide / 4][kSide + kBeyond];
};

// A bijection that mixes all bits ("lowbias32" of C. Wellons, hash-prospector, 2018).
uint32_t mixed(uint32_t h) {
  h ^= h >> 16;
  h *= 0x7feb352du;
  h ^= h >> 15;
  h *= 0x846ca68bu;
  h ^= h >> 16;
  return h;
}

// Data shared by all rows of a tile that lie between the same rows of cells.
struct Strip {
  uint32_t first;              // coordinate of the first column
  const float *upper, *lower;  // strengths in the rows of cells above and below
  const Noise* noise;
};

// Adds noise to rows of a tile from `first` to before `end`. place: coordinate of row 0; part: position of each row
// from upper to lower, 0 to 1. A word of noise has one byte for each of four rows.
template <int W>
SG_INLINE void add_body(const Strip& strip, int place, const float* part, int first, int end, float* accumulators) {
  using V = Simd<W>;
  using F = typename V::F;
  using I = typename V::I;
  using U = typename Lanes<W>::U;
  constexpr int kVectors = kTileWidth / W;
  F upper[kVectors], change[kVectors];
  for (int i = 0; i < kVectors; ++i) {
    upper[i] = V::load(strip.upper + i * W);
    change[i] = V::load(strip.lower + i * W) - upper[i];
  }
  for (int row = first; row < end;) {
    const int at = (place + row) & (kSide - 1);
    U noise[kVectors];
    const auto& words = strip.noise->words;
    std::memcpy(noise, &words[at / 4][strip.first % kSide], sizeof noise);
    __builtin_prefetch(&words[(at / 4 + 2) % (kSide / 4)][strip.first % kSide]);
    for (int i = 0; i < kVectors; ++i) noise[i] >>= 8 * (at & 3);
    for (const int next = std::min(row + 4 - (at & 3), end); row < next; ++row) {
      float* out = accumulators + row * 3 * kTileWidth;
      for (int i = 0; i < kVectors; ++i, out += W) {
        const U bytes = noise[i] & 255u;
        I whole;
        std::memcpy(&whole, &bytes, sizeof whole);
        const F value = (__builtin_convertvector(whole, F) - kMiddle) * (upper[i] + change[i] * part[row]);
        for (int k = 0; k < 3; ++k) V::store(out + k * kTileWidth, V::load(out + k * kTileWidth) + value);
        noise[i] >>= 8;
      }
    }
  }
}

using Add = void (*)(const Strip&, int place, const float* part, int first, int end, float* accumulators);
constexpr Add kAdd[] = {
    for_baseline<add_body<4>>,
#if SG_X86
    for_avx2<add_body<8>>,
    for_avx512<add_body<16>>,
#endif
};

// Positions of a level's samples between cells, along one axis: the cell before each sample (clamped), and the position
// from it to the next, 0 to 1.
struct Between {
  // cell, corner: output pixels; number: of cells; place, count: of samples.
  Between(int level, double cell, double corner, int number, int place, int count) : cells(count), parts(count) {
    const double step = std::ldexp(1.0, level) / cell, first = 0.5 * step - corner / cell - 0.5, last = number - 1;
    for (int i = 0; i < count; ++i) {
      const double at = std::min(std::max(first + (place + i) * step, 0.0), last);
      cells[i] = static_cast<int>(at);
      parts[i] = static_cast<float>(at - cells[i]);
    }
  }
  std::vector<int> cells;
  std::vector<float> parts;
};

// The strength of a code: half a level for code 1, and a factor of sqrt(2) for each further code. The noise has these
// spreads.
constexpr double kSpreads[kTextureOctaves] = {34.1, 29.7};
float strength_of(int code, double spread) {
  if (code == 0) return 0.0f;
  const double half_levels = std::ldexp((code - 1) % 2 == 0 ? 1.0 : 1.4142135623730951, (code - 1) / 2);
  return static_cast<float>(half_levels / (2.0 * spread * 255.0));
}

// Separable filter of a periodic plane.
using Plane = std::vector<int>;
template <int N>
Plane filtered(const Plane& plane, const int (&weights)[N]) {
  const auto at = [](int i, int k) { return (i + k - N / 2) & (kSide - 1); };
  Plane along(kSide * kSide), sums(kSide * kSide);
  for (int row = 0; row < kSide; ++row)
    for (int i = 0; i < kSide; ++i)
      for (int k = 0; k < N; ++k) along[row * kSide + i] += weights[k] * plane[row * kSide + at(i, k)];
  for (int row = 0; row < kSide; ++row)
    for (int k = 0; k < N; ++k)
      for (int i = 0; i < kSide; ++i) sums[row * kSide + i] += weights[k] * along[at(row, k) * kSide + i];
  return sums;
}

// White noise, from -128 to 127, minus its local mean. The finest octave is also smoothed, because it is not enlarged.
Noise make_noise(int octave) {
  Plane noise(kSide * kSide), white(kSide * kSide);
  for (int row = 0; row < kSide; ++row) {
    const uint32_t key = mixed(mixed(uint32_t{1}) + static_cast<uint32_t>(row >> 2));
    for (int i = 0; i < kSide; ++i)
      white[row * kSide + i] = static_cast<int>(mixed(key + static_cast<uint32_t>(i)) >> 8 * (row & 3) & 255) - 128;
  }
  const Plane mean = octave == 0 ? filtered(white, {1, 4, 6, 4, 1}) : filtered(white, {1, 2, 1});
  const int whole = octave == 0 ? 256 : 16, shift = octave == 0 ? 14 : 5;
  for (size_t i = 0; i < noise.size(); ++i) noise[i] = whole * white[i] - mean[i];
  if (octave == 0) noise = filtered(noise, {1, 6, 1});
  Noise table{};
  for (int row = 0; row < kSide; ++row)
    for (int i = 0; i < kSide + kBeyond; ++i) {
      const int value = (noise[row * kSide + i % kSide] + (1 << shift >> 1)) >> shift;
      table.words[row / 4][i] |= static_cast<uint32_t>(value + 128) << 8 * (row % 4);
    }
  return table;
}

const Noise& noise_of(int octave) {
  static const Noise tables[kTextureOctaves] = {make_noise(0), make_noise(1)};
  return tables[octave];
}

}  // namespace

std::vector<uint8_t> unpack_texture(const uint8_t* data, size_t size, int width, int height, size_t& used) {
  const size_t rows = texture_cells(height), columns = texture_cells(width), cells = rows * columns;
  std::vector<uint8_t> codes;
  uint64_t at = 0;  // bit
  const auto bit = [&] {
    if (at / 8 >= size) refuse<std::runtime_error>("the file ends within its texture");
    const int value = data[at / 8] >> (7 - at % 8) & 1;
    ++at;
    return value;
  };
  for (int octave = 0; octave < kTextureOctaves; ++octave) {
    int64_t above = 0;
    for (size_t row = 0; row < rows; ++row) {
      int64_t coded = above;
      for (size_t column = 0; column < columns; ++column) {
        int64_t ones = 0;
        while (bit() != 0) ++ones;
        coded += ones % 2 == 0 ? ones / 2 : -(ones + 1) / 2;
        if (column == 0) above = coded;
        const int64_t code = coded + (octave == 0 ? 0 : codes[codes.size() - cells]);
        if (code < 0 || code >= kTextureStrengths)
          refuse<std::runtime_error>("a strength of the file's texture is out of range");
        codes.push_back(static_cast<uint8_t>(code));
      }
    }
  }
  while (at % 8 != 0)
    if (bit() != 0) refuse<std::runtime_error>("the padding of the file's texture is not zero");
  used = at / 8;
  return codes;
}

Texture::Texture(const uint8_t* codes, const TextureGrid& grid) : grid_(grid) {
  const auto fits = [](double v) { return std::abs(v) <= 1e9; };
  const bool possible = grid.columns > 0 && grid.rows > 0 && grid.cell_x >= 0.5 && grid.cell_y >= 0.5 &&
                        fits(grid.cell_x) && fits(grid.cell_y) && fits(grid.x) && fits(grid.y) &&
                        std::abs(grid.shift) <= 8;
  if (!possible) refuse<std::invalid_argument>("the texture's cells cannot be placed");
  const size_t cells = static_cast<size_t>(grid.columns) * static_cast<size_t>(grid.rows);
  strengths_.resize(kTextureOctaves * cells);
  for (int octave = 0; octave < kTextureOctaves; ++octave) {
    const int level = octave + grid.shift;
    const float share = level == 0 && grid.shift < 0 ? kUnenlarged : 1.0f;
    for (size_t i = octave * cells; i < (octave + 1) * cells; ++i) {
      if (codes[i] >= kTextureStrengths) refuse<std::invalid_argument>("there is no such strength of texture");
      strengths_[i] = share * strength_of(codes[i], kSpreads[octave]);
      if (codes[i] != 0) top_ = std::max(top_, level);
    }
  }
}

TextureLayer::TextureLayer(const Texture& texture, int level, int x, int y, int columns, int rows)
    : octave_(level - texture.grid_.shift), x_(x), y_(y), strips_(columns / kTileWidth) {
  const TextureGrid& grid = texture.grid_;
  if (octave_ < 0 || octave_ >= kTextureOctaves || level > texture.top()) return;
  const Between across(level, grid.cell_x, grid.x, grid.columns, x, columns);
  Between down(level, grid.cell_y, grid.y, grid.rows, y, rows);
  const int first = down.cells.front(), end = down.cells.back() + 2;  // including the cell after the last sample
  strengths_.resize(static_cast<size_t>(end - first) * static_cast<size_t>(columns));
  busy_.resize(static_cast<size_t>(end - first) * static_cast<size_t>(strips_));
  float* strength = strengths_.data();
  uint8_t* busy = busy_.data();
  for (int row = first; row < end; ++row) {
    const int64_t row_of_all = int64_t{octave_} * grid.rows + std::min(row, grid.rows - 1);
    const float* from = &texture.strengths_[row_of_all * grid.columns];
    for (int i = 0; i < columns; ++i) {
      const float left = from[across.cells[i]], right = from[std::min(across.cells[i] + 1, grid.columns - 1)];
      strength[i] = left + (right - left) * across.parts[i];
    }
    for (int strip = 0; strip < strips_; ++strip, strength += kTileWidth)
      *busy++ = std::any_of(strength, strength + kTileWidth, [](float s) { return s > 0.0f; });
  }
  for (int& cell : down.cells) cell -= first;
  cells_ = std::move(down.cells);
  parts_ = std::move(down.parts);
}

void TextureLayer::add(int isa, int x, int y, int first_row, int end_row, float* accumulators) const {
  if (strengths_.empty()) return;
  const int* cells = &cells_[y - y_];
  const int across = (x - x_) / kTileWidth, stride = strips_ * kTileWidth;
  Strip strip{static_cast<uint32_t>(x), nullptr, nullptr, &noise_of(octave_)};
  for (int row = first_row; row < end_row;) {
    int end = row + 1;
    while (end < end_row && cells[end] == cells[row]) ++end;
    const int64_t cell = cells[row];
    if (busy_[cell * strips_ + across] || busy_[(cell + 1) * strips_ + across]) {
      strip.upper = &strengths_[cell * stride + across * kTileWidth];
      strip.lower = strip.upper + stride;
      kAdd[isa](strip, y, &parts_[y - y_], row, end, accumulators);
    }
    row = end;
  }
}

}  // namespace sg
