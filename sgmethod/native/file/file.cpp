#include "file/file.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>

#include "core/constants.h"
#include "core/errors.h"
#include "file/fields.h"
#include "texture/texture.h"

namespace sg {
namespace {

constexpr size_t kFewestBytes = 7, kPrefixBytes = 8, kSignatureBytes = 2, kTableBytes = 136;
constexpr int kColorBits = 3, kCodebook = 48;  // of an entry; values of both codebooks

// CRC-32 of zlib, four bits at a time.
uint32_t checksum_of(const uint8_t* p, size_t size) {
  uint32_t table[16];
  for (uint32_t i = 0; i < 16; ++i) {
    table[i] = i;
    for (int k = 0; k < 4; ++k) table[i] = table[i] >> 1 ^ (table[i] & 1 ? 0xEDB88320 : 0);
  }
  uint32_t crc = ~0u;
  for (const uint8_t* end = p + size; p != end; ++p) {
    crc ^= *p;
    crc = crc >> 4 ^ table[crc & 15];
    crc = crc >> 4 ^ table[crc & 15];
  }
  return ~crc;
}

// Of binary32, and of binary16.
float float_of(const uint8_t* p) {
  const uint32_t bits = number(p, 4);
  float value;
  std::memcpy(&value, &bits, sizeof value);
  return value;
}
float half_of(const uint8_t* p) {
  const uint32_t bits = number(p, 2), exponent = bits >> 10 & 31, fraction = bits & 1023;
  require(exponent != 31, "a table of the file holds a value that is not finite");
  const float size = std::ldexp(static_cast<float>(exponent == 0 ? fraction : 1024 + fraction),
                                static_cast<int>(std::max(exponent, 1u)) - 25);
  return bits >> 15 ? -size : size;
}

struct Range {
  double low, high;
  float value(uint32_t code, int bits) const {
    return static_cast<float>(low + code * ((high - low) / static_cast<double>((1u << bits) - 1)));
  }
};

int record_bits(int position_bits, int bitwidth) { return 2 * position_bits + 3 * bitwidth + 2 * kColorBits; }

void read_v1(Header& h, const uint8_t* p) {
  const auto [profile, width, height, position_bits, groups] = values_of(kHeaderV1, p);
  h.profile = static_cast<int>(profile);
  h.width = static_cast<int>(width);
  h.height = static_cast<int>(height);
  h.position_bits = static_cast<int>(position_bits);
  h.groups = static_cast<int>(groups);
  h.cutoff = kCutoffV1;
}

double quantum_of(uint32_t code) { return std::ldexp(1.0 + (code & 0xFF) / 256.0, 4 - static_cast<int>(code >> 8)); }

void describe(Header& h, uint32_t flags, std::array<uint32_t, 2> size, double quantum, std::array<uint32_t, 3> background) {
  h.profile = 2;
  h.width = static_cast<int>(size[0]);
  h.height = static_cast<int>(size[1]);
  h.quantum = quantum;
  for (int k = 0; k < 3; ++k) h.background[k] = static_cast<uint8_t>(background[k]);
  h.grey = flags & 1;
  h.upright = flags & 2;
  h.cutoff = kCutoffV3;
  h.pyramid = h.version >= 4;
  h.textured = flags & 4;
  h.with_alpha = flags & 8;
  h.is_short = flags & 16;
}

void read_v3(Header& h, const uint8_t* p) {
  const auto [flags, width, height, quantum, red, green, blue] = values_of(h.version == 3 ? kHeaderV3 : kHeaderV4, p);
  describe(h, flags, {width, height}, quantum_of(quantum), {red, green, blue});
}

// The groups of version 1, their records checked to be all there.
void check_v1(const Header& h, const uint8_t* p, size_t size) {
  const size_t lists = kTableBytes + kGroupBytes * static_cast<size_t>(h.groups);
  require(h.groups == 0 ? size == 0 : size >= lists, "the file's size is not what its header says");
  if (h.groups == 0) return;
  uint64_t total = 0, bits = 0;
  for (const uint8_t* group = p + kTableBytes; group != p + lists; group += kGroupBytes) {
    const auto [bitwidth, gaussians] = values_of(kGroup, group);
    total += gaussians;
    bits += uint64_t{gaussians} * static_cast<uint64_t>(record_bits(h.position_bits, static_cast<int>(bitwidth)));
  }
  require(total <= static_cast<uint64_t>(h.width) * static_cast<uint64_t>(h.height), "more Gaussians than pixels");
  require(size - lists == (bits + 7) / 8, "the file's size is not what its header says");
  require(bits % 8 == 0 || (p[size - 1] & 0xFF >> bits % 8) == 0, "the file's padding is not zero");
  for (int i = 0; i < 10; ++i)
    require(std::isfinite(float_of(p + 4 * i)), "a table of the file holds a value that is not finite");
  for (int i = 0; i < kCodebook; ++i) half_of(p + 40 + 2 * i);
}

// What the first bytes say, of which there are four.
int version_of(const uint8_t* data) {
  const bool has_magic = std::memcmp(data, "SGM", 3) == 0;
  require(has_magic || (data[0] == 0xD3 && data[1] > 0xC4 && data[1] < 0xD0), "this is not an .sg file");
  const int version = has_magic ? data[3] : data[1] & 15;
  const bool known = has_magic ? version == 1 || version == 3 || version == 4 : version == 5;
  require(known, "this version of the format is not known to this decoder");
  return version;
}

constexpr char kDamaged[] = "the file is damaged: its checksum does not match";
constexpr char kCutAlpha[] = "the file is damaged: its alpha is cut short";

}  // namespace

File::File(const uint8_t* data, size_t size) {
  require(size >= kFewestBytes, "the file is too short");
  header_.version = version_of(data);
  if (header_.version >= 5) read_v5(data, size);
  else read_with_prefix(data, size);
}

// Versions before 5.
void File::read_with_prefix(const uint8_t* data, size_t size) {
  Header& h = header_;
  const size_t begin = kPrefixBytes + (h.version == 1 ? bytes_of(kHeaderV1) : bytes_of(kHeaderV4));
  require(size >= begin, "the file is too short");
  h.checksum = number(data + 4, 4);
  require(checksum_of(data + kPrefixBytes, size - kPrefixBytes) == h.checksum, kDamaged);
  if (h.version == 1) read_v1(h, data + kPrefixBytes);
  else read_v3(h, data + kPrefixBytes);
  set_picture(data + begin, size - begin);
  if (h.version == 1) check_v1(h, picture_.begin, picture_.size);
  if (h.textured) read_texture();
  if (h.with_alpha) read_alpha();
}

void File::read_v5(const uint8_t* data, size_t size) {
  Header& h = header_;
  const bool is_short = data[kSignatureBytes] & 0x80, grey = data[kSignatureBytes] & 8;
  const int checksum_bytes = is_short ? 1 : 4;
  const uint8_t* const end = data + size - checksum_bytes;
  h.checksum = number(end, checksum_bytes);
  const uint32_t found = checksum_of(data, static_cast<size_t>(end - data));
  require((is_short ? found & 255 : found) == h.checksum, kDamaged);
  const uint8_t* const begin = data + kSignatureBytes;
  HeaderBits bits(begin, static_cast<size_t>(end - begin), is_short);
  const auto [flags, width, height, quantum, red, green, blue] = bits.values_of(kHeaderV5, grey ? 5 : 7);
  describe(h, flags, {width, height}, quantum_of(quantum + 256), {red, green, blue});
  if (h.with_alpha) {
    const auto [alpha_quantum, alpha_background, alpha_bytes] = bits.values_of(kAlphaHeaderV5);
    const auto level = static_cast<uint8_t>(alpha_background);
    alpha_ = {nullptr, alpha_bytes - 1, quantum_of(alpha_quantum + 256), true, false, {level, level, level}};
  }
  const uint8_t* const parts = bits.end();
  set_picture(parts, static_cast<size_t>(end - parts));
  if (h.textured) read_texture();
  require(picture_.size >= alpha_.size, kCutAlpha);
  alpha_.begin = picture_.begin;
  picture_.begin += alpha_.size;
  picture_.size -= alpha_.size;
}

void File::set_picture(const uint8_t* begin, size_t size) {
  const Header& h = header_;
  require(int64_t{h.width} * h.height <= kMaxPixels, "the picture has too many pixels");
  picture_ = {begin, size, h.quantum, h.grey, h.upright, {}};
  std::copy_n(h.background, 3, picture_.background);
}

// At the beginning of what is left.
void File::read_texture() {
  size_t used = 0;
  texture_ = unpack_texture(picture_.begin, picture_.size, header_.width, header_.height, used);
  picture_.begin += used;
  picture_.size -= used;
}

// At the beginning of what is left.
void File::read_alpha() {
  const uint8_t* p = picture_.begin;
  require(picture_.size >= kAlphaBytes, kCutAlpha);
  const auto [quantum, background, bytes] = values_of(kAlphaHeader, p);
  require(picture_.size - kAlphaBytes >= bytes, kCutAlpha);
  const auto level = static_cast<uint8_t>(background);
  alpha_ = {p + kAlphaBytes, bytes, quantum_of(quantum), true, false, {level, level, level}};
  picture_.begin += kAlphaBytes + bytes;
  picture_.size -= kAlphaBytes + bytes;
}

GaussianArrays File::gaussians(double prefix) const {
  if (!(prefix > 0 && prefix <= 1)) refuse<std::invalid_argument>("the prefix must lie above 0 and at most at 1");
  if (header_.version == 1) {
    if (prefix < 1) refuse<std::invalid_argument>("version 1 has no order that a prefix could follow");
    return gaussians_v1();
  }
  return gaussians_of(picture_, prefix);
}

GaussianArrays File::gaussians_of(const Layer& l, double prefix) const {
  const Header& h = header_;
  const auto used = static_cast<size_t>(std::ceil(prefix * static_cast<double>(l.size)));
  return rd_decode({h.width, h.height, l.quantum, l.grey, l.upright, std::min(h.version, 4), h.is_short}, l.begin, used, prefix < 1, kMaxGaussians,
                   l.size - used);
}

GaussianArrays File::gaussians_v1() const {
  GaussianArrays out;
  if (header_.groups == 0) return out;
  Range ranges[5];  // x, y, l1, l2, l3
  for (int i = 0; i < 5; ++i) ranges[i] = {float_of(picture_.begin + 8 * i), float_of(picture_.begin + 8 * i + 4)};
  float entries[kCodebook];
  for (int i = 0; i < kCodebook; ++i) entries[i] = half_of(picture_.begin + 40 + 2 * i);
  const uint8_t *group = picture_.begin + kTableBytes, *const end = group + kGroupBytes * static_cast<size_t>(header_.groups);
  Bits bits(end);
  for (; group != end; group += kGroupBytes) {
    const auto [bitwidth, gaussians] = values_of(kGroup, group);
    for (uint32_t n = 0; n < gaussians; ++n) {
      for (int i = 0; i < 5; ++i) {
        const int width = i < 2 ? header_.position_bits : static_cast<int>(bitwidth);
        (i < 2 ? out.means : out.factors).push_back(ranges[i].value(bits.take(width), width));
      }
      const float* first = entries + 3 * bits.take(kColorBits);
      const float* second = entries + kCodebook / 2 + 3 * bits.take(kColorBits);
      for (int k = 0; k < 3; ++k) out.colors.push_back(first[k] + second[k]);
    }
  }
  return out;
}

}  // namespace sg
