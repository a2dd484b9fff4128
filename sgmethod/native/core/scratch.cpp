#include "core/scratch.h"

#include <pthread.h>

#include <algorithm>
#include <mutex>
#include <new>
#include <utility>

namespace sg {
namespace {

constexpr size_t kMostKept = 8;

struct Kept {
  std::mutex lock;
  std::vector<std::vector<float>> blocks;  // none in use
};

// It lives as long as the process: other threads may draw while it ends.
Kept& kept() {
  static Kept* const all = new Kept;
  return *all;
}

// Another thread may have held the lock when a child was forked.
[[maybe_unused]] const int watched = pthread_atfork(nullptr, nullptr, [] { new (&kept().lock) std::mutex; });

}  // namespace

Scratch::Scratch(size_t floats) {
  {
    Kept& all = kept();
    const std::lock_guard<std::mutex> hold(all.lock);
    const auto enough = [&](const auto& block) { return block.size() >= floats && block.size() / 2 <= floats; };
    const auto found = std::find_if(all.blocks.begin(), all.blocks.end(), enough);
    if (found != all.blocks.end()) {
      floats_ = std::move(*found);
      all.blocks.erase(found);
      return;
    }
  }
  floats_.resize(floats);
}

Scratch::~Scratch() {
  Kept& all = kept();
  const std::lock_guard<std::mutex> hold(all.lock);
  if (all.blocks.capacity() == 0) all.blocks.reserve(kMostKept + 1);  // so that nothing below throws
  all.blocks.push_back(std::move(floats_));
  if (all.blocks.size() > kMostKept) all.blocks.erase(all.blocks.begin());  // the one that was used longest ago
}

}  // namespace sg
