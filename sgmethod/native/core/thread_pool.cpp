#include "core/thread_pool.h"

#include <sched.h>
#include <unistd.h>
#include <xmmintrin.h>

#include <algorithm>
#include <atomic>
#include <condition_variable>
#include <cstdlib>
#include <memory>
#include <mutex>
#include <thread>
#include <vector>

namespace sg {
namespace {

// A waiting thread polls this often before it sleeps: long enough to bridge the gap between the phases of
// one render, short enough not to take a core from anyone.
constexpr int kSpins = 10000;
constexpr int kMaxThreads = 256;

// Results far below one grey level need no subnormal numbers, and some processors are slow with them.
// Flush-to-zero is the same in every instruction set used here, so pixels stay identical.
class FlushSubnormals {
 public:
  FlushSubnormals() : saved_(_mm_getcsr()) { _mm_setcsr(saved_ | 0x8040); }
  ~FlushSubnormals() { _mm_setcsr(saved_); }

 private:
  unsigned saved_;
};

int initial_thread_count() {
  if (const char* text = std::getenv("SG_THREADS")) {
    const int count = std::atoi(text);
    if (count > 0) return std::min(count, kMaxThreads);
  }
  cpu_set_t cores;
  if (sched_getaffinity(0, sizeof cores, &cores) == 0) return std::min(CPU_COUNT(&cores), kMaxThreads);
  return 1;
}

class Pool {
 public:
  explicit Pool(int threads) : pid_(getpid()), shares_(threads) {
    for (int i = 1; i < threads; ++i) workers_.emplace_back([this, i] { work(i); });
  }

  ~Pool() {
    {
      std::lock_guard<std::mutex> lock(mutex_);
      stop_ = true;
    }
    wake_.notify_all();
    for (auto& worker : workers_) worker.join();
  }

  int size() const { return static_cast<int>(shares_.size()); }
  bool forked() const { return pid_ != getpid(); }

  void run(int count, const std::function<void(int)>& task) {
    {
      std::lock_guard<std::mutex> lock(mutex_);
      task_ = &task;
      for (int i = 0; i < size(); ++i) {
        shares_[i].next.store(static_cast<int>(int64_t{count} * i / size()), std::memory_order_relaxed);
        shares_[i].end = static_cast<int>(int64_t{count} * (i + 1) / size());
      }
      open_ = true;
      generation_.fetch_add(1, std::memory_order_release);
    }
    wake_.notify_all();
    drain(0);
    {
      std::lock_guard<std::mutex> lock(mutex_);
      open_ = false;  // a worker that wakes only now is not waited for: its core may be busy elsewhere
    }
    for (int spin = 0; active_.load(std::memory_order_acquire) != 0;) {
      if (++spin < kSpins) _mm_pause();
      else std::this_thread::yield();
    }
  }

 private:
  // A share of the tasks that follow each other, the same from call to call, because neighbours and phases of one render
  // share memory; then what others have left.
  struct alignas(64) Share {
    std::atomic<int> next{0};
    int end = 0;
  };

  void drain(int thread) {
    FlushSubnormals flush;
    for (int k = 0; k < size(); ++k) {
      Share& share = shares_[(thread + k) % size()];
      for (int i; (i = share.next.fetch_add(1, std::memory_order_relaxed)) < share.end;) (*task_)(i);
    }
  }

  void work(int thread) {
    unsigned seen = 0;
    while (true) {
      for (int spin = 0; spin < kSpins && generation_.load(std::memory_order_acquire) == seen; ++spin) _mm_pause();
      if (generation_.load(std::memory_order_acquire) == seen) {
        std::unique_lock<std::mutex> lock(mutex_);
        wake_.wait(lock, [&] { return stop_ || generation_.load(std::memory_order_relaxed) != seen; });
        if (stop_) return;
      }
      {
        std::lock_guard<std::mutex> lock(mutex_);
        if (stop_) return;
        seen = generation_.load(std::memory_order_relaxed);
        if (!open_) continue;
        active_.fetch_add(1, std::memory_order_relaxed);
      }
      drain(thread);
      active_.fetch_sub(1, std::memory_order_release);
    }
  }

  const pid_t pid_;
  std::vector<Share> shares_;
  std::vector<std::thread> workers_;
  std::mutex mutex_;
  std::condition_variable wake_;
  std::atomic<unsigned> generation_{0};
  std::atomic<int> active_{0};  // workers inside the current task
  bool open_ = false;  // a task is being handed out
  bool stop_ = false;
  const std::function<void(int)>* task_ = nullptr;
};

std::mutex entry;
int wanted = 0;
Pool* pool = nullptr;  // lives as long as the process: joining at exit could wait on threads already gone

}  // namespace

int thread_count() {
  std::lock_guard<std::mutex> lock(entry);
  if (wanted == 0) wanted = initial_thread_count();
  return wanted;
}

void set_thread_count(int count) {
  std::lock_guard<std::mutex> lock(entry);
  wanted = std::clamp(count, 1, kMaxThreads);
}

void parallel_for(int count, const std::function<void(int)>& task) {
  std::lock_guard<std::mutex> lock(entry);
  if (wanted == 0) wanted = initial_thread_count();
  if (pool && pool->forked()) pool = nullptr;  // its threads did not survive the fork
  if (!pool || pool->size() != wanted) {
    delete pool;
    pool = new Pool(wanted);
  }
  pool->run(count, task);
}

}  // namespace sg
