// Runs all tests, or those whose names begin with the argument.
#include <cstdio>
#include <cstring>
#include <mutex>

#include "check.h"
#include "core/thread_pool.h"

namespace {

check::Case* cases = nullptr;
int failures = 0;
std::mutex failing;

}  // namespace

check::Case::Case(const char* name, void (*run)()) : name(name), run(run), next(cases) { cases = this; }

void check::fail(const char* file, int line, const char* what) {
  const std::lock_guard<std::mutex> lock(failing);
  std::fprintf(stderr, "%s:%d: not so: %s\n", file, line, what);
  ++failures;
}

int main(int count, char** arguments) {
  const char* wanted = count > 1 ? arguments[1] : "";
  int run = 0;
  sg::set_thread_count(4);
  for (const check::Case* test = cases; test; test = test->next) {
    if (std::strncmp(test->name, wanted, std::strlen(wanted)) != 0) continue;
    const int before = failures;
    try {
      test->run();
    } catch (const std::exception& error) {
      check::fail(test->name, 0, error.what());
    }
    std::printf("%s %s\n", failures == before ? "ok    " : "FAILED", test->name);
    ++run;
  }
  std::printf("%d tests, %d failures\n", run, failures);
  return run == 0 || failures != 0;
}
