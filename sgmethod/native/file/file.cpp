#include "file/file.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>

#include "core/constants.h"
#include "core/errors.h"
#include "texture/texture.h"

namespace sg {
namespace {

constexpr size_t kPrefixBytes = 8, kTableBytes = 136;
constexpr int kColorBits = 3, kCodebook = 48;  // of an entry; values of both codebooks

// Headers as sgmethod/bitstream/ has them: tests/native/decoder/test_fields.py compares.
struct Field {
  int bytes;
  uint32_t low, high;  // of the value
  uint32_t also = low;  // one value more
};
constexpr std::array kHeaderV1 = {
    Field{1, 0, 1},      // profile
    Field{2, 1, 65535},  // width
    Field{2, 1, 65535},  // height
    Field{1, 1, 16},     // position_bits
    Field{1, 0, 16},     // groups
};
constexpr std::array kGroup = {
    Field{1, 1, 16},        // bitwidth
    Field{3, 1, 16777215},  // gaussians
};
constexpr auto header_of(uint32_t most_flags) {
  return std::array{
      Field{1, 0, most_flags},  // flags
      Field{2, 1, 65535},       // width
      Field{2, 1, 65535},       // height
      Field{2, 256, 3839, 0},   // quantum
      Field{1, 0, 255},         // red
      Field{1, 0, 255},         // green
      Field{1, 0, 255},         // blue
  };
}
constexpr auto kHeaderV3 = header_of(3), kHeaderV4 = header_of(15);
constexpr std::array kAlphaHeader = {
    Field{2, 256, 3839, 0},   // quantum
    Field{1, 0, 255},         // background
    Field{4, 0, 4294967295},  // bytes
};

template <size_t N>
constexpr size_t bytes_of(const std::array<Field, N>& fields) {
  size_t bytes = 0;
  for (const Field& field : fields) bytes += static_cast<size_t>(field.bytes);
  return bytes;
}
constexpr size_t kGroupBytes = bytes_of(kGroup), kAlphaBytes = bytes_of(kAlphaHeader);

void require(bool condition, const char* message) {
  if (!condition) refuse<std::runtime_error>(message);
}

uint32_t number(const uint8_t* p, int bytes) {
  uint32_t value = 0;
  for (int i = 0; i < bytes; ++i) value = value << 8 | p[i];
  return value;
}

// The values of a header's fields, which are all there.
template <size_t N>
std::array<uint32_t, N> values_of(const std::array<Field, N>& fields, const uint8_t* p) {
  std::array<uint32_t, N> values;
  for (size_t i = 0; i < N; p += fields[i++].bytes) {
    const auto& [bytes, low, high, also] = fields[i];
    const uint32_t value = values[i] = number(p, bytes);
    require((low <= value && value <= high) || value == also, "a header field is out of range");
  }
  return values;
}

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

// Codes bit by bit, the most significant first.
class Bits {
 public:
  explicit Bits(const uint8_t* p) : next_(p) {}
  uint32_t take(int count) {
    for (; left_ < count; left_ += 8) word_ = word_ << 8 | *next_++;
    left_ -= count;
    return static_cast<uint32_t>(word_ >> left_ & ((uint64_t{1} << count) - 1));
  }

 private:
  const uint8_t* next_;
  uint64_t word_ = 0;
  int left_ = 0;
};

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

void read_v3(Header& h, const uint8_t* p) {
  const auto [flags, width, height, quantum, red, green, blue] = values_of(h.version == 3 ? kHeaderV3 : kHeaderV4, p);
  h.profile = 2;
  h.width = static_cast<int>(width);
  h.height = static_cast<int>(height);
  h.quantum = quantum_of(quantum);
  h.background[0] = static_cast<uint8_t>(red);
  h.background[1] = static_cast<uint8_t>(green);
  h.background[2] = static_cast<uint8_t>(blue);
  h.grey = flags & 1;
  h.upright = flags & 2;
  h.cutoff = kCutoffV3;
  h.pyramid = h.version == 4;
  h.textured = flags & 4;
  h.with_alpha = flags & 8;
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

}  // namespace

File::File(const uint8_t* data, size_t size) {
  require(size >= kPrefixBytes, "the file is too short");
  require(std::memcmp(data, "SGM", 3) == 0, "this is not an .sg file");
  const int version = data[3];
  require(version == 1 || version == 3 || version == 4, "this version of the format is not known to this decoder");
  const size_t begin = kPrefixBytes + (version == 1 ? bytes_of(kHeaderV1) : bytes_of(kHeaderV4));
  require(size >= begin, "the file is too short");
  header_.version = version;
  header_.checksum = number(data + 4, 4);
  require(checksum_of(data + kPrefixBytes, size - kPrefixBytes) == header_.checksum,
          "the file is damaged: its checksum does not match");
  if (version == 1) read_v1(header_, data + kPrefixBytes);
  else read_v3(header_, data + kPrefixBytes);
  require(int64_t{header_.width} * header_.height <= kMaxPixels, "the picture has too many pixels");
  const Header& h = header_;
  picture_ = {data + begin, size - begin, h.quantum, h.grey, h.upright, {}};
  std::copy_n(h.background, 3, picture_.background);
  if (version == 1) check_v1(h, picture_.begin, picture_.size);
  if (h.textured) {
    size_t used = 0;
    texture_ = unpack_texture(picture_.begin, picture_.size, h.width, h.height, used);
    picture_.begin += used;
    picture_.size -= used;
  }
  if (h.with_alpha) read_alpha();
}

// At the beginning of what is left.
void File::read_alpha() {
  const uint8_t* p = picture_.begin;
  require(picture_.size >= kAlphaBytes, "the file is damaged: its alpha is cut short");
  const auto [quantum, background, bytes] = values_of(kAlphaHeader, p);
  require(picture_.size - kAlphaBytes >= bytes, "the file is damaged: its alpha is cut short");
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
  return rd_decode({h.width, h.height, l.quantum, l.grey, l.upright, h.version}, l.begin, used, prefix < 1, kMaxGaussians,
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
