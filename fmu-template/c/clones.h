/*
 * CLONED precedes functions that GCC compiles for x86-64 three times: with AVX-512, with AVX2, and without. The dynamic
 * linker chooses when the library is loaded. INLINED precedes functions that these call: inlined, they are compiled for
 * the same processor.
 *
 * Both leave plain C99 for other processors and compilers, for C libraries other than that of GNU, and where the
 * compiler may use AVX anyway. So they do without optimization, with -Os, with -DMETAFMU_PLAIN, and with sanitizers,
 * which are not ready when the linker chooses.
 */
#ifndef CLONES_H
#define CLONES_H

#include <limits.h> /* identifies the C library */

#if defined(__x86_64__) && defined(__linux__) && defined(__GLIBC__) && !defined(__UCLIBC__) && defined(__GNUC__)        \
    && !defined(__clang__) && defined(__OPTIMIZE__) && !defined(__OPTIMIZE_SIZE__) && !defined(__AVX__)                \
    && !defined(__SANITIZE_ADDRESS__) && !defined(__SANITIZE_THREAD__) && !defined(METAFMU_PLAIN)
#if __GNUC__ >= 12
#define CLONED __attribute__((target_clones("arch=x86-64-v4", "arch=x86-64-v3", "default")))
#define INLINED inline __attribute__((always_inline))
#endif
#endif

#ifndef CLONED
#define CLONED
#define INLINED inline
#endif

#endif
