// Memory reused from call to call. A fit needs the same few megabytes a thousand times, and fresh pages cost more time
// than the computation in them.
#pragma once

#include <cstddef>
#include <memory>

namespace sg {

// Uninitialised floats, whose pages the threads that write them first ask the system for. Throws std::bad_alloc.
class Scratch {
 public:
  struct Block {
    std::unique_ptr<float[]> floats;
    size_t size = 0;
  };
  explicit Scratch(size_t floats);
  ~Scratch();
  Scratch(const Scratch&) = delete;
  Scratch& operator=(const Scratch&) = delete;
  float* get() { return block_.floats.get(); }

 private:
  Block block_;
};

// Returns memory kept for later calls, and the C library's free memory, to the system.
void release_memory();

}  // namespace sg
