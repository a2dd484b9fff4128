// How the core says that something cannot be.
#pragma once

#include <stdexcept>

namespace sg {

// Where there are no exceptions, as in WebAssembly: the embedder defines it, and ends the call.
[[noreturn]] void end_call(const char* message);

// Throws an Error.
template <typename Error>
[[noreturn, gnu::cold, gnu::noinline]] void refuse(const char* message) {
#ifdef __cpp_exceptions
  throw Error(message);
#else
  end_call(message);
#endif
}

}  // namespace sg
