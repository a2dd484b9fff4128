#include "core/scratch.h"

#include <algorithm>
#include <mutex>
#include <new>
#include <utility>

#include "core/platform.h"

#ifdef __GLIBC__
#include <malloc.h>
#endif

namespace sg {
namespace {

constexpr size_t kMaxKept = 24;         // blocks: more than a step of a fit holds at once
constexpr size_t kMaxFloats = 1 << 25;  // kept in all, 128 MB: a huge picture must not hold its memory for good

struct Kept {
  Kept() { blocks.reserve(kMaxKept + 1); }  // so that returning a block never throws
  std::mutex lock;
  std::vector<std::vector<float>> blocks;  // free ones, least recently used first
};

// Never destroyed, because other threads may draw while the process ends.
Kept* const kept = new Kept;

// Another thread may have held the lock when a child was forked.
[[maybe_unused]] const int watched = in_children([] { new (kept) Kept; });

size_t floats_of(const std::vector<std::vector<float>>& blocks) {
  size_t sum = 0;
  for (const auto& block : blocks) sum += block.size();
  return sum;
}

}  // namespace

Scratch::Scratch(size_t floats) {
  {
    auto& blocks = kept->blocks;
    const std::lock_guard<std::mutex> hold(kept->lock);
    const auto enough = [&](const auto& block) { return block.size() >= floats && block.size() / 2 <= floats; };
    const auto found = std::find_if(blocks.begin(), blocks.end(), enough);
    if (found != blocks.end()) {
      floats_ = std::move(*found);
      blocks.erase(found);
      return;
    }
  }
  floats_.resize(floats);
}

Scratch::~Scratch() {
  if (floats_.empty()) return;
  auto& blocks = kept->blocks;
  const std::lock_guard<std::mutex> hold(kept->lock);
  blocks.push_back(std::move(floats_));
  while (blocks.size() > kMaxKept || floats_of(blocks) > kMaxFloats) blocks.erase(blocks.begin());
}

void release_memory() {
  {
    const std::lock_guard<std::mutex> hold(kept->lock);
    kept->blocks.clear();
  }
#if defined(__GLIBC__) && !defined(__SANITIZE_ADDRESS__)  // its allocator replaces glibc's
  malloc_trim(0);
#endif
}

}  // namespace sg
