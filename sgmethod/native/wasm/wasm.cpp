// What the WebAssembly module exports to decoder.js. An instance reads one file, and is thrown away with all its memory.
#include <memory>
#include <vector>

#include "core/errors.h"
#include "file/file.h"

// Throws in JavaScript, and so ends the call.
extern "C" [[noreturn]] void refused(const char* message) __attribute__((import_module("sg"), import_name("refused")));

void sg::end_call(const char* message) { refused(message); }

namespace {

std::vector<uint8_t> data;
std::unique_ptr<sg::File> file;
double fields[10];

}  // namespace

#define SG_EXPORT(name) extern "C" __attribute__((export_name(#name)))

// Room for the file's bytes.
SG_EXPORT(room) uint8_t* room(size_t bytes) {
  data.resize(bytes);
  return data.data();
}

SG_EXPORT(open) void open() { file = std::make_unique<sg::File>(data.data(), data.size()); }

// Version, profile, width, height, checksum, number of Gaussians, background, whether there is alpha.
SG_EXPORT(info) const double* info() {
  const sg::Header& h = file->header();
  const size_t of_alpha = h.with_alpha ? file->alpha().means.size() / 2 : 0;
  const auto gaussians = static_cast<double>(file->gaussians().means.size() / 2 + of_alpha);
  const double all[] = {static_cast<double>(h.version), static_cast<double>(h.profile), static_cast<double>(h.width),
                        static_cast<double>(h.height), static_cast<double>(h.checksum), gaussians,
                        static_cast<double>(h.background[0]), static_cast<double>(h.background[1]),
                        static_cast<double>(h.background[2]), static_cast<double>(h.with_alpha)};
  for (int i = 0; i < 10; ++i) fields[i] = all[i];
  return fields;
}

// Width, height, and where the pixels lie: rows of red, green, blue and alpha.
SG_EXPORT(draw) const double* draw(double scale, double prefix, int x, int y, int width, int height, int whole,
                                     int texture) {
  const sg::View view{scale, prefix, whole != 0, x, y, width, height, texture != 0};
  const sg::Size size = sg::size_of(file->header(), view);
  const size_t count = static_cast<size_t>(size.width) * static_cast<size_t>(size.height);
  auto* pixels = new uint8_t[4 * count];
  const uint8_t* rgb = pixels + count;  // no pixel is overwritten before it is read
  sg::draw(*file, view, pixels + count);
  for (size_t i = 0; i < count; ++i) {
    const uint8_t red = rgb[3 * i], green = rgb[3 * i + 1], blue = rgb[3 * i + 2];
    uint8_t* to = pixels + 4 * i;
    to[0] = red, to[1] = green, to[2] = blue, to[3] = 255;
  }
  if (file->header().with_alpha) {
    std::vector<uint8_t> grey(3 * count);
    sg::draw_alpha(*file, view, grey.data());
    for (size_t i = 0; i < count; ++i) pixels[4 * i + 3] = grey[3 * i];
  }
  fields[0] = size.width;
  fields[1] = size.height;
  fields[2] = static_cast<double>(reinterpret_cast<uintptr_t>(pixels));
  return fields;
}
