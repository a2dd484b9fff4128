// The thread pool: every task once, exceptions, nested calls, subnormal numbers, forks, several callers. Memory that
// calls hand on.
#include "core/platform.h"
#include "core/scratch.h"
#include "core/thread_pool.h"

#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <functional>
#include <new>
#include <stdexcept>
#include <string>
#include <thread>
#include <vector>

#include "check.h"

namespace {

constexpr int kThreads[] = {1, 2, 5, 40};

constexpr sg::FloatMode kInTasks = sg::kPlainMode | sg::kFlushMode;
#if SG_X86
constexpr sg::FloatMode kUpwardsAndTraps = 0x4000 | (sg::kPlainMode & ~0x1F80u);  // traps every exception
#else
constexpr sg::FloatMode kUpwardsAndTraps = sg::kPlainMode;
#endif

// Without the flags of exceptions that have happened.
sg::FloatMode mode() { return SG_X86 ? sg::float_mode() & ~sg::FloatMode{0x3F} : sg::float_mode(); }

// Runs tasks of which each counts its calls; returns whether every one ran once.
bool all_run_once(int count) {
  std::vector<std::atomic<int>> calls(count);
  sg::parallel_for(count, [&](int i) { ++calls[i]; });
  for (const auto& c : calls)
    if (c != 1) return false;
  return true;
}

}  // namespace

TEST(pool_runs_every_task_once) {
  for (const int threads : kThreads) {
    sg::set_thread_count(threads);
    for (const int count : {0, 1, 2, 7, 1000}) CHECK(all_run_once(count));
  }
}

TEST(pool_hands_an_exception_to_the_caller) {
  for (const int threads : kThreads) {
    sg::set_thread_count(threads);
    for (const int bad : {0, 1, 50, 99}) {
      std::vector<std::atomic<int>> calls(100);
      std::string message;
      try {
        sg::parallel_for(100, [&](int i) {
          ++calls[i];
          if (i == bad) throw std::runtime_error("task " + std::to_string(i));
        });
      } catch (const std::runtime_error& error) {
        message = error.what();
      }
      CHECK(message == "task " + std::to_string(bad));
      for (const auto& c : calls) CHECK(c <= 1);
      CHECK(all_run_once(100));
    }
  }
}

TEST(pool_works_on_what_has_come_while_more_comes) {
  for (const int threads : kThreads) {
    sg::set_thread_count(threads);
    for (const int count : {0, 1, 7, 8, 9, 1000}) {
      std::vector<int> values(count);  // each written before it is announced
      std::vector<std::atomic<int>> calls(count);
      const auto bring = [&](const std::function<void(int)>& there) {
        for (int i = 0; i < count; ++i) {
          values[i] = i + 1;
          if (i % 3 == 2 || i + 1 == count) there(i + 1);
        }
      };
      const int found = sg::parallel_while(8, bring, [&](int first, int last, int chunk) {
        CHECK(first == 8 * chunk && last > first && last <= first + 8);
        for (int i = first; i < last; ++i) calls[i] += values[i] == i + 1;
      });
      CHECK(found == count);
      for (const auto& c : calls) CHECK(c == 1);
    }
  }
}

TEST(pool_hands_on_what_ends_the_coming) {
  for (const int threads : kThreads) {
    sg::set_thread_count(threads);
    const auto bring = [](const std::function<void(int)>& there) {
      there(20);
      throw std::runtime_error("no more");
    };
    CHECK(check::throws<std::runtime_error>([&] { sg::parallel_while(8, bring, [](int, int, int) {}); }));
    const auto comes = [](const std::function<void(int)>& there) { there(20); };
    const auto fail = [](int, int, int) { throw std::bad_alloc(); };
    CHECK(check::throws<std::bad_alloc>([&] { sg::parallel_while(8, comes, fail); }));
    CHECK(all_run_once(100));
  }
}

TEST(pool_runs_a_call_within_a_task_where_it_is) {
  for (const int threads : kThreads) {
    sg::set_thread_count(threads);
    std::atomic<int> calls{0};
    sg::parallel_for(20, [&](int) {
      const auto self = std::this_thread::get_id();
      sg::parallel_for(30, [&](int) {
        CHECK(std::this_thread::get_id() == self);
        sg::parallel_for(2, [&](int) { ++calls; });
      });
    });
    CHECK(calls == 20 * 30 * 2);
    CHECK(check::throws<std::range_error>([] {
      sg::parallel_for(20, [](int) { sg::parallel_for(30, [](int) { throw std::range_error("within"); }); });
    }));
    std::atomic<int> caught{0};
    sg::parallel_for(20, [&](int) {
      const auto fail = [](int) { throw std::range_error("kept"); };
      caught += check::throws<std::range_error>([&] { sg::parallel_for(3, fail); });
    });
    CHECK(caught == 20);
    CHECK(all_run_once(100));
  }
}

TEST(pool_has_its_own_float_mode_within_tasks_and_gives_the_callers_back) {
  const volatile float zero = 0.0f;
  for (const sg::FloatMode callers : {sg::kPlainMode, kUpwardsAndTraps})
    for (const int threads : kThreads) {
      const sg::WithMode as_the_caller(callers);
      sg::set_thread_count(threads);
      sg::parallel_for(100, [&](int) {
        CHECK(mode() == kInTasks);
        CHECK(1.0f / zero > 1.0f);
        sg::parallel_for(2, [](int) { CHECK(mode() == kInTasks); });
        CHECK(check::throws<int>([] { sg::parallel_for(2, [](int i) { throw i; }); }));
        CHECK(mode() == kInTasks);
      });
      CHECK(mode() == callers);
      CHECK(check::throws<int>([] { sg::parallel_for(100, [](int i) { throw i; }); }));
      CHECK(mode() == callers);
    }
}

TEST(pool_serves_several_callers) {
  sg::set_thread_count(4);
  std::vector<std::thread> callers;
  for (int c = 0; c < 6; ++c)
    callers.emplace_back([c] {
      for (int k = 0; k < 50; ++k) {
        if (c == 0) sg::set_thread_count(1 + k % 5);
        if (c == 1) CHECK(check::throws<int>([] { sg::parallel_for(30, [](int i) { throw i; }); }));
        else CHECK(all_run_once(30));
      }
    });
  for (auto& caller : callers) caller.join();
}

TEST(pool_serves_a_child_forked_while_a_kernel_runs) {
  sg::set_thread_count(3);
  std::atomic<bool> running{false}, stop{false};
  std::thread other([&] {
    sg::parallel_for(3, [&](int) {
      running = true;
      while (!stop) std::this_thread::yield();
    });
  });
  while (!running) std::this_thread::yield();
  const pid_t child = fork();
  if (child == 0) {
    alarm(60);
    const bool right = all_run_once(100) && check::throws<int>([] { sg::parallel_for(9, [](int i) { throw i; }); });
    const pid_t grandchild = fork();
    if (grandchild == 0) _exit(all_run_once(100) ? 0 : 1);
    int status = -1;
    waitpid(grandchild, &status, 0);
    _exit(right && status == 0 ? 0 : 1);
  }
  int status = -1;
  waitpid(child, &status, 0);
  CHECK(status == 0);
  stop = true;
  other.join();
  CHECK(all_run_once(100));
}

// Whether two pieces of memory in use at once are each the holder's own.
bool own_memory(size_t floats, float value) {
  sg::Scratch first(floats), second(floats / 2);
  std::fill_n(first.get(), floats, value);
  std::fill_n(second.get(), floats / 2, -value);
  return std::count(first.get(), first.get() + floats, value) == static_cast<ptrdiff_t>(floats);
}

TEST(scratch_is_one_holders_at_a_time) {
  std::vector<std::thread> holders;
  for (int h = 1; h <= 6; ++h)
    holders.emplace_back([h] {
      for (size_t k = 0; k < 200; ++k) {
        CHECK(own_memory(k * k % 997 * h, static_cast<float>(h)));
        if (k % 50 == 0) sg::release_memory();
      }
    });
  for (auto& holder : holders) holder.join();
  CHECK(own_memory(0, 1));
}

TEST(scratch_is_handed_on) {
  float* before;
  {
    sg::Scratch scratch(1 << 20);
    before = scratch.get();
  }
  CHECK(sg::Scratch((1 << 20) - 9).get() == before);
  CHECK(sg::Scratch(1 << 18).get() != before);
}

TEST(scratch_serves_a_child_forked_while_others_use_it) {
  std::atomic<bool> warm{false}, stop{false};
  std::thread other([&] {
    while (!stop) {
      own_memory(5000, 1);
      warm = true;
    }
  });
  // Its first round allocates. GCC 12's thread sanitizer does not hold its allocator's locks while it forks, so that a
  // child born meanwhile would wait for them without an end.
  while (!warm) std::this_thread::yield();
  for (int k = 0; k < 20; ++k) {
    const pid_t child = fork();
    if (child == 0) {
      alarm(60);
      _exit(own_memory(5000, 1) && own_memory(9, 1) ? 0 : 1);
    }
    int status = -1;
    waitpid(child, &status, 0);
    CHECK(status == 0);
  }
  stop = true;
  other.join();
}
