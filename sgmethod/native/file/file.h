// A whole .sg file (docs/format.md), read and drawn without Python: what sgmethod/bitstream/ does of it for decoding, for
// machines that have the kernels alone.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "rd/codec.h"

namespace sg {

constexpr int64_t kMaxPixels = 100'000'000;  // of a picture or a view: a file may claim any size

// What a file says of itself.
struct Header {
  int version;
  uint32_t checksum;
  int width, height;         // pixels
  int profile;               // 0 baseline, 1 paper, 2 rd
  uint8_t background[3];     // red, green, blue
  float cutoff;              // sigma at which a Gaussian ends
  bool pyramid;              // whether wide Gaussians are drawn on coarser levels
  // Of version 1.
  int position_bits, groups;
  // Of the others.
  double quantum;
  bool grey, upright, textured, with_alpha;
  bool is_short;  // since version 5
};

// A payload of profile rd, and the header fields that may differ between a picture and its alpha.
struct Layer {
  const uint8_t* begin;
  size_t size;
  double quantum;
  bool grey, upright;
  uint8_t background[3];  // red, green, blue
};

// A part of a picture, at any size (docs/format.md, Views).
struct View {
  double scale = 1.0;            // output pixels for a pixel of the picture, 1/64 to 64
  double prefix = 1.0;           // the part of the payload that is used, above 0 to 1
  bool whole = true;             // or a region, in pixels of the picture
  int x = 0, y = 0, width = 0, height = 0;
  bool texture = true;           // whether it is drawn
};

// A file in memory, which must outlive it.
class File {
 public:
  // Throws std::runtime_error for anything but a whole, intact file of at most kMaxPixels; of profile rd the payload is not
  // looked at.
  File(const uint8_t* data, size_t size);

  const Header& header() const { return header_; }
  // Codes of strengths (texture/texture.h), none without texture.
  const std::vector<uint8_t>& texture() const { return texture_; }
  // Throws std::runtime_error for a payload that no encoder writes, std::invalid_argument for a prefix of version 1 or one
  // that is out of its range.
  GaussianArrays gaussians(double prefix = 1.0) const;
  // Those of alpha, which are grey; only where the header says that there are any.
  GaussianArrays alpha() const { return gaussians_of(alpha_, 1.0); }
  uint8_t alpha_background() const { return alpha_.background[0]; }

 private:
  GaussianArrays gaussians_v1() const;
  GaussianArrays gaussians_of(const Layer& layer, double prefix) const;
  void read_with_prefix(const uint8_t* data, size_t size);
  void read_v5(const uint8_t* data, size_t size);
  void set_picture(const uint8_t* begin, size_t size);
  void read_texture();
  void read_alpha();
  Header header_{};
  Layer picture_{}, alpha_{};  // of version 1, picture_ is what follows the header
  std::vector<uint8_t> texture_;
};

// Output pixels of a view. Throws std::invalid_argument for one that makes no picture, std::runtime_error for too many.
struct Size {
  int width, height;
};
Size size_of(const Header& header, const View& view);

// pixels [height, width, 3] of 8 bits, without alpha. Throws as the above do, and std::overflow_error for Gaussians that
// overlap beyond what a picture needs.
void draw(const File& file, const View& view, uint8_t* pixels);
// Alpha of the same pixels, as grey, where a file has it.
void draw_alpha(const File& file, const View& view, uint8_t* pixels);

}  // namespace sg
