// Python's lock. A thread that asks for it once the program is ending does not get it: Python up to 3.13 unwinds its
// stack, which destructors must not let pass, so that the process would abort. Here it waits for the end instead.
#pragma once

#include <nanobind/nanobind.h>

#include <cxxabi.h>

#include <chrono>
#include <thread>

#include "core/platform.h"

// The result of a function of Python.
template <typename Function>
auto within_program(const Function& function) {
#ifdef __GLIBCXX__
  try {
    return function();
  } catch (const abi::__forced_unwind&) {
    while (true) std::this_thread::sleep_for(std::chrono::hours(1));
  }
#else
  return function();
#endif
}

// While a kernel runs: others may run Python, and the caller's floating-point mode does not count.
class Unlocked {
 public:
  Unlocked() : state_(PyEval_SaveThread()) {}
  ~Unlocked() {
    within_program([&] { PyEval_RestoreThread(state_); });
  }
  Unlocked(const Unlocked&) = delete;
  Unlocked& operator=(const Unlocked&) = delete;

 private:
  PyThreadState* state_;
  const sg::WithMode mode_;
};

// This thread, which Python may not know, may run Python meanwhile.
class Locked {
 public:
  Locked() : state_(within_program([] { return PyGILState_Ensure(); })) {}
  ~Locked() { PyGILState_Release(state_); }
  Locked(const Locked&) = delete;
  Locked& operator=(const Locked&) = delete;

 private:
  PyGILState_STATE state_;
};
