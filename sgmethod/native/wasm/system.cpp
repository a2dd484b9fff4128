// Threads, and memory that calls hand on, where there is one thread and a few calls.
#include "core/scratch.h"
#include "core/thread_pool.h"

namespace sg {

int thread_count() { return 1; }

void parallel_for(int count, const std::function<void(int)>& task) {
  for (int i = 0; i < count; ++i) task(i);
}

int parallel_while(int size, const std::function<void(const std::function<void(int)>& there)>& bring,
                   const std::function<void(int, int, int)>& body) {
  int count = 0;
  bring([&](int n) { count = n; });
  parallel_chunks(count, size, body);
  return count;
}

Scratch::Scratch(size_t floats) : floats_(floats) {}
Scratch::~Scratch() = default;

}  // namespace sg
