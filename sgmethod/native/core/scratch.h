// Memory that calls hand on to each other. A fit needs the same some megabytes a thousand times, and pages that are new
// to the process cost more time than what is computed in them.
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

// Gives back to the system what is kept for later calls, and what the C library keeps of freed memory.
void release_memory();

}  // namespace sg
