// Preloaded: grants so many new threads and then no more, as a system does that has reached a limit.
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <limits.h>
#include <pthread.h>
#include <stdatomic.h>

static atomic_int left = INT_MAX;

void grant_threads(int count) { atomic_store(&left, count); }

int pthread_create(pthread_t* thread, const pthread_attr_t* attributes, void* (*run)(void*), void* argument) {
  static int (*create)(pthread_t*, const pthread_attr_t*, void* (*)(void*), void*);
  if (atomic_fetch_sub(&left, 1) <= 0) return EAGAIN;
  if (!create) create = dlsym(RTLD_NEXT, "pthread_create");
  return create(thread, attributes, run, argument);
}
