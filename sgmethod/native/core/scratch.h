// Memory reused from call to call. A fit needs the same few megabytes a thousand times, and fresh pages cost more time
// than the computation in them.
#pragma once

#include <cstddef>
#include <vector>

namespace sg {

// Uninitialised floats. Throws std::bad_alloc.
class Scratch {
 public:
  explicit Scratch(size_t floats);
  ~Scratch();
  Scratch(const Scratch&) = delete;
  Scratch& operator=(const Scratch&) = delete;
  float* get() { return floats_.data(); }

 private:
  std::vector<float> floats_;
};

// Returns memory kept for later calls, and the C library's free memory, to the system.
void release_memory();

}  // namespace sg
