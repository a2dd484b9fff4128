// A small thread pool for all kernels. Each thread begins with its own share and then helps others, so it is not fixed
// which thread runs which task; kernels therefore write only to memory that belongs to their task.
#pragma once

#include <algorithm>
#include <functional>

namespace sg {

// Most threads used by parallel_for, including the calling one; fewer if the system refuses more. One at first.
int thread_count();
void set_thread_count(int count);

// From now on the calling thread runs its tasks itself, at the same time as others run theirs; its thread_count() is 1.
void stay_alone();

// Runs task(0) ... task(count - 1) and returns when all are done. Calls from several threads take turns; a call from
// within a task runs on its thread. If a task throws, tasks that have not begun are skipped, and the first exception is
// rethrown to the caller. A forked child starts its own pool.
void parallel_for(int count, const std::function<void(int)>& task);

// Calls body(first, last, chunk) for [0, count) in tasks of `size`.
template <typename Body>
void parallel_chunks(int count, int size, const Body& body) {
  parallel_for((count + size - 1) / size,
               [&](int chunk) { body(chunk * size, std::min(count, (chunk + 1) * size), chunk); });
}

// Processes items while they are still being produced: calls body(first, last, chunk) for chunks of `size` (the last
// may be smaller). bring() produces them, and now and then calls there(n) once the first n are there. Returns their
// number.
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
