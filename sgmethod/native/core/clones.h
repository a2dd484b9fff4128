// For loops that the compiler makes vectors of by itself: a function for several instruction sets, of which the loader
// picks one. Not under the thread sanitizer, which cannot watch it do so yet.
#pragma once

#ifdef __SANITIZE_THREAD__
#define SG_CLONES
#else
#define SG_CLONES __attribute__((target_clones("avx512f", "avx2", "default")))
#endif
