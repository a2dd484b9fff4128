// Preloaded: makes one allocation fail, the one of a given number since fail_allocation(). Counted are those that the
// kernels' own code asks for, or all of the threads beside the main one.
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <link.h>
#include <stdatomic.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>
#include <unistd.h>

extern void* __libc_malloc(size_t);
extern void* __libc_calloc(size_t, size_t);
extern void* __libc_realloc(void*, size_t);
extern void* __libc_memalign(size_t, size_t);

typedef struct {
  const char* name;  // a part of the file's
  uintptr_t low, high;
} Code;

static atomic_long counted, wanted;  // wanted 0: nothing fails, nothing is counted
static int of_other_threads;         // are counted, and not those of the kernels' code
static Code kernels = {"/_native.", 0, 0}, loader = {"/ld-linux", 0, 0};
static void (*throw_bad_alloc)(void);

static int find(struct dl_phdr_info* info, size_t size, void* data) {
  Code* code = data;
  (void)size;
  if (!strstr(info->dlpi_name, code->name)) return 0;
  for (int i = 0; i < info->dlpi_phnum; ++i) {
    if (info->dlpi_phdr[i].p_type != PT_LOAD || !(info->dlpi_phdr[i].p_flags & PF_X)) continue;
    code->low = info->dlpi_addr + info->dlpi_phdr[i].p_vaddr;
    code->high = code->low + info->dlpi_phdr[i].p_memsz;
  }
  return 1;
}

static int within(uintptr_t caller, const Code* code) { return caller >= code->low && caller < code->high; }

void fail_allocation(long number, int other_threads) {
  void* library = dlopen("libstdc++.so.6", RTLD_NOLOAD | RTLD_LAZY);
  throw_bad_alloc = (void (*)(void))dlsym(library, "_ZSt17__throw_bad_allocv");
  dl_iterate_phdr(find, &kernels);
  dl_iterate_phdr(find, &loader);
  of_other_threads = other_threads;
  atomic_store(&counted, 0);
  atomic_store(&wanted, number);
}

// Returns how many were counted.
long fail_no_more(void) {
  atomic_store(&wanted, 0);
  return atomic_load(&counted);
}

static int fails(const void* caller) {
  if (atomic_load(&wanted) == 0) return 0;
  // The loader ends the process when it has no memory for what a thread keeps for itself. The pool makes it ask as the
  // thread starts, where nothing better can be done.
  const int counts = of_other_threads ? gettid() != getpid() && !within((uintptr_t)caller, &loader)
                                      : within((uintptr_t)caller, &kernels);
  return counts && atomic_fetch_add(&counted, 1) + 1 == atomic_load(&wanted);
}

static void* none(void) {
  errno = ENOMEM;
  return NULL;
}

#define CALLER __builtin_return_address(0)

void* malloc(size_t size) { return fails(CALLER) ? none() : __libc_malloc(size); }
void* calloc(size_t count, size_t size) { return fails(CALLER) ? none() : __libc_calloc(count, size); }
void* realloc(void* old, size_t size) { return fails(CALLER) ? none() : __libc_realloc(old, size); }
void* aligned_alloc(size_t alignment, size_t size) { return fails(CALLER) ? none() : __libc_memalign(alignment, size); }

// operator new, also that for types with an alignment of their own.
static void* new(const void* caller, size_t alignment, size_t size) {
  void* memory = fails(caller) ? NULL : __libc_memalign(alignment, size);
  if (!memory) throw_bad_alloc();
  return memory;
}
void* _Znwm(size_t size) { return new(CALLER, 16, size); }
void* _Znam(size_t size) { return new(CALLER, 16, size); }
void* _ZnwmSt11align_val_t(size_t size, size_t alignment) { return new(CALLER, alignment, size); }
