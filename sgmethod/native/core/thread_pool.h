// One small thread pool for all kernels. Each thread begins with a share of its own and then helps others, so which
// thread runs which task is not fixed; kernels therefore write only to memory that belongs to their task.
#pragma once

#include <algorithm>
#include <functional>

namespace sg {

// Number of threads that parallel_for uses, the calling one included. Starts as SG_THREADS from the
// environment, else as the number of cores this process may run on.
int thread_count();
void set_thread_count(int count);

// Runs task(0) ... task(count - 1) and returns when all are done. Calls from several threads take turns.
void parallel_for(int count, const std::function<void(int)>& task);

// Calls body(first, last, chunk) for [0, count) in tasks of `size`.
template <typename Body>
void parallel_chunks(int count, int size, const Body& body) {
  parallel_for((count + size - 1) / size, [&](int chunk) { body(chunk * size, std::min(count, (chunk + 1) * size), chunk); });
}

// Calls body(i) for [0, count) in tasks of `size`.
template <typename Body>
void parallel_each(int count, int size, const Body& body) {
  parallel_chunks(count, size, [&](int first, int last, int) {
    for (int i = first; i < last; ++i) body(i);
  });
}

}  // namespace sg
