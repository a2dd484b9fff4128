// Throwing errors out of line, so that the checks before them stay small.
#pragma once

#include <stdexcept>

namespace sg {

// Throws an Error.
template <typename Error>
[[noreturn, gnu::cold, gnu::noinline]] void refuse(const char* message) {
  throw Error(message);
}

}  // namespace sg
