// Tests that register themselves, and checks that say where they fail.
#pragma once

#include <exception>

namespace check {

struct Case {
  Case(const char* name, void (*run)());
  const char* name;
  void (*run)();
  Case* next;
};

// Prints the place and counts it.
void fail(const char* file, int line, const char* what);

// Whether the call throws an Error, and nothing else.
template <typename Error, typename Call>
bool throws(const Call& call) {
  try {
    call();
  } catch (const Error&) {
    return true;
  } catch (...) {
  }
  return false;
}

}  // namespace check

#define TEST(name)                                       \
  static void name();                                    \
  static const check::Case case_of_##name(#name, &name); \
  static void name()

#define CHECK(...) ((__VA_ARGS__) ? void() : check::fail(__FILE__, __LINE__, #__VA_ARGS__))
