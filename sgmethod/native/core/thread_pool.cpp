#include "core/thread_pool.h"

#include <algorithm>
#include <atomic>
#include <condition_variable>
#include <cstdint>
#include <exception>
#include <mutex>
#include <new>
#include <system_error>
#include <thread>
#include <utility>
#include <vector>

#include "core/platform.h"

namespace sg {
namespace {

// A waiting thread polls this often before it sleeps: long enough to bridge the gap between the phases of one render,
// short enough not to occupy a core for long.
constexpr int kSpins = 10000;
constexpr int kMaxThreads = 256;

SG_STORED_AT_START thread_local bool inside_task = false;  // whether this thread is running a task
SG_STORED_AT_START thread_local bool alone = false;        // whether this thread keeps away from the pool

// Flushes subnormal numbers to zero while a task runs, because some processors are slow with them. They are far below
// one grey level and no pixel depends on them, so machines that keep them draw the same.
class TaskMode {
 public:
  TaskMode() { inside_task = true; }
  ~TaskMode() { inside_task = false; }

 private:
  const WithMode mode_{kPlainMode | kFlushMode};
};

class Pool {
 public:
  // Starts as many of the wanted threads as the system allows.
  explicit Pool(int wanted) : shares_(wanted) {
    workers_.reserve(wanted - 1);
    try {
      for (int i = 1; i < wanted; ++i) workers_.emplace_back([this, i] { work(i); });
    } catch (const std::system_error&) {
    } catch (const std::bad_alloc&) {
    }
    size_ = static_cast<int>(workers_.size()) + 1;
  }

  ~Pool() {
    {
      std::lock_guard<std::mutex> lock(mutex_);
      stop_ = true;
    }
    wake_.notify_all();
    for (auto& worker : workers_) worker.join();
  }

  int wanted() const { return static_cast<int>(shares_.size()); }

  void run(int count, const std::function<void(int)>& task) {
    {
      std::lock_guard<std::mutex> lock(mutex_);
      task_ = &task;
      for (int i = 0; i < size_; ++i) {
        shares_[i].next.store(static_cast<int>(int64_t{count} * i / size_), std::memory_order_relaxed);
        shares_[i].end = static_cast<int>(int64_t{count} * (i + 1) / size_);
      }
      open_ = true;
      generation_.fetch_add(1, std::memory_order_release);
    }
    wake_.notify_all();
    drain(0);
    {
      std::lock_guard<std::mutex> lock(mutex_);
      open_ = false;  // do not wait for a worker that wakes only now: its core may be busy elsewhere
    }
    for (int spin = 0; active_.load(std::memory_order_acquire) != 0;) {
      if (++spin < kSpins) wait_a_moment();
      else std::this_thread::yield();
    }
    if (error_) std::rethrow_exception(std::exchange(error_, nullptr));
  }

 private:
  // A thread's own tasks, done before it helps others: consecutive ones, because neighbours share memory, and the same
  // from call to call, because the phases of one render share memory.
  struct alignas(64) Share {
    std::atomic<int> next{0};
    int end = 0;
  };

  void drain(int thread) noexcept {
    const TaskMode mode;
    try {
      for (int k = 0; k < size_; ++k) {
        Share& share = shares_[(thread + k) % size_];
        for (int i; (i = share.next.fetch_add(1, std::memory_order_relaxed)) < share.end;) (*task_)(i);
      }
    } catch (...) {
      fail(std::current_exception());
    }
  }

  // Keeps the first exception, and skips all tasks that have not begun.
  void fail(std::exception_ptr error) {
    std::lock_guard<std::mutex> lock(mutex_);
    if (!error_) error_ = std::move(error);
    for (int i = 0; i < size_; ++i) shares_[i].next.store(shares_[i].end, std::memory_order_relaxed);
  }

  void work(int thread) {
    // Makes the loader allocate this thread's exception state now. At the first exception there may be no memory for
    // it, which would end the process.
    static_cast<void>(std::current_exception());
    unsigned seen = 0;
    while (true) {
      for (int spin = 0; spin < kSpins && generation_.load(std::memory_order_acquire) == seen; ++spin) wait_a_moment();
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

  std::vector<Share> shares_;  // one per wanted thread
  std::vector<std::thread> workers_;
  int size_;  // actual threads, including the calling one
  std::mutex mutex_;
  std::condition_variable wake_;
  std::atomic<unsigned> generation_{0};
  std::atomic<int> active_{0};  // workers inside the current task
  bool open_ = false;  // a task is being handed out
  bool stop_ = false;
  std::exception_ptr error_;  // of the current task
  const std::function<void(int)>* task_ = nullptr;
};

std::mutex entry;
std::atomic<int> wanted{1};
Pool* pool = nullptr;        // never destroyed: joining at exit could wait for threads already gone

// A forked child has only the thread that forked: the pool's threads are gone, and another thread may have held the
// lock. It gets a new lock, and at its first call a new pool.
void start_afresh() {
  new (&entry) std::mutex;
  pool = nullptr;
}

// Registered when the library is loaded, before any kernel can run.
[[maybe_unused]] const int watched = in_children(start_afresh);

}  // namespace

int thread_count() { return alone ? 1 : wanted.load(); }

void stay_alone() { alone = true; }

void set_thread_count(int count) { wanted.store(std::clamp(count, 1, kMaxThreads)); }

void parallel_for(int count, const std::function<void(int)>& task) {
  if (inside_task) {
    for (int i = 0; i < count; ++i) task(i);
    return;
  }
  if (alone || count <= 1) {  // one task wakes nobody
    const TaskMode mode;
    for (int i = 0; i < count; ++i) task(i);
    return;
  }
  const std::lock_guard<std::mutex> lock(entry);
  const int threads = thread_count();
  if (!pool || pool->wanted() != threads) {
    delete std::exchange(pool, nullptr);
    pool = new Pool(threads);
  }
  pool->run(count, task);
}

int parallel_while(int size, const std::function<void(const std::function<void(int)>& there)>& bring,
                   const std::function<void(int, int, int)>& body) {
  std::atomic<int> there{0}, next{0};
  std::atomic<bool> ended{false};
  const auto come = [&] {
    // Lets waiting threads continue even if bring() throws.
    struct End {
      std::atomic<bool>& ended;
      ~End() { ended.store(true, std::memory_order_release); }
    } const end{ended};
    bring([&](int n) { there.store(n, std::memory_order_release); });
  };
  parallel_for(thread_count(), [&](int task) {
    if (task == 0) come();
    while (true) {
      const int chunk = next.fetch_add(1, std::memory_order_relaxed), first = chunk * size;
      const auto enough = [&] { return there.load(std::memory_order_acquire) >= first + size; };
      for (int spin = 0; !ended.load(std::memory_order_acquire) && !enough();)
        ++spin < kSpins ? wait_a_moment() : std::this_thread::yield();
      const int last = std::min(there.load(std::memory_order_acquire), first + size);
      if (first >= last) return;
      body(first, last, chunk);
    }
  });
  return there.load();
}

}  // namespace sg
