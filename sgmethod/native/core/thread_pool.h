// One small thread pool for all kernels. Each thread begins with a share of its own and then helps others, so which
// thread runs which task is not fixed; kernels therefore write only to memory that belongs to their task.
#pragma once

#include <algorithm>
#include <functional>

namespace sg {

// Number of threads that parallel_for uses at most, the calling one included; there are fewer where the system refuses
// more. Starts as SG_THREADS from the environment, else as the number of cores this process may use.
int thread_count();
void set_thread_count(int count);

// Runs task(0) ... task(count - 1) and returns when all are done. Calls from several threads take turns; a call from
// within a task runs where it is. If a task throws, tasks that have not begun are left out, and the first exception
// reaches the caller. After a fork the child starts with a pool of its own.
void parallel_for(int count, const std::function<void(int)>& task);

// Calls body(first, last, chunk) for [0, count) in tasks of `size`.
template <typename Body>
void parallel_chunks(int count, int size, const Body& body) {
  parallel_for((count + size - 1) / size, [&](int chunk) {
    body(chunk * size, std::min(count, (chunk + 1) * size), chunk);
  });
}

// Calls body(first, last, chunk) for what comes one after the other, in chunks of `size` (the last may be smaller), while
// more of it still comes. `bring` calls there(n) when the first n are there, which may be seldom. Returns how many came.
int parallel_while(int size, const std::function<void(const std::function<void(int)>& there)>& bring,
                   const std::function<void(int, int, int)>& body);

// Calls body(i) for [0, count) in tasks of `size`.
template <typename Body>
void parallel_each(int count, int size, const Body& body) {
  parallel_chunks(count, size, [&](int first, int last, int) {
    for (int i = first; i < last; ++i) body(i);
  });
}

}  // namespace sg
