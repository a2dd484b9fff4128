// Decodes files without Python, as tests/native/harness/decoders.py asks. Each line of stdin is a request,
//     scale prefix x y width height path
// with width 0 for the whole picture. The answer is a line "width height" and the pixels in RGBA, or a line "refused why".
#include <cstdint>
#include <cstdio>
#include <exception>
#include <fstream>
#include <iostream>
#include <iterator>
#include <sstream>
#include <string>
#include <vector>

#ifdef _WIN32
#include <fcntl.h>
#include <io.h>
#endif

#include "file/file.h"

namespace {

void answer(const std::string& request) {
  sg::View view;
  std::string path;
  std::istringstream line(request);
  line >> view.scale >> view.prefix >> view.x >> view.y >> view.width >> view.height >> std::ws;
  std::getline(line, path);
  view.whole = view.width == 0;
  std::ifstream stream(path, std::ios::binary);
  const std::vector<char> bytes{std::istreambuf_iterator<char>(stream), {}};
  const sg::File file(reinterpret_cast<const uint8_t*>(bytes.data()), bytes.size());
  const sg::Size size = sg::size_of(file.header(), view);
  const size_t count = static_cast<size_t>(size.width) * static_cast<size_t>(size.height);
  std::vector<uint8_t> rgb(3 * count), alpha(3 * count, 255), pixels(4 * count);
  sg::draw(file, view, rgb.data());
  if (file.header().with_alpha) sg::draw_alpha(file, view, alpha.data());
  for (size_t i = 0; i < 4 * count; ++i) pixels[i] = i % 4 == 3 ? alpha[i / 4 * 3] : rgb[i / 4 * 3 + i % 4];
  std::printf("%d %d\n", size.width, size.height);
  std::fwrite(pixels.data(), 1, pixels.size(), stdout);
}

}  // namespace

int main() {
#ifdef _WIN32
  _setmode(_fileno(stdout), _O_BINARY);
#endif
  for (std::string request; std::getline(std::cin, request);) {
    try {
      answer(request);
    } catch (const std::exception& error) {
      std::printf("refused %s\n", error.what());
    }
  }
  return 0;
}
