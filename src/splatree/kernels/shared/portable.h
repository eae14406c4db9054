// What the shared maths needs from its surroundings: these headers are pure functions of scalars without branches, so that a
// compiler turns a loop over lanes that calls them into vector code; a CUDA compiler makes of them the code of one thread.
#pragma once

#if defined(__CUDACC__)
#define SPLATREE_FN static __device__ __forceinline__
// The names under which GCC and Clang have what they vectorise.
#define __builtin_sqrtf sqrtf
#define __builtin_ceilf ceilf
#define __builtin_floorf floorf
#define __builtin_sqrt sqrt
#define __builtin_log2 log2
#define __builtin_fabsf fabsf
#define __builtin_fabs fabs
#else
#define SPLATREE_FN static inline __attribute__((always_inline))
#endif

namespace splatree {
namespace {

#ifdef __CUDACC__
SPLATREE_FN int bits_of(float x) { return __float_as_int(x); }
SPLATREE_FN float float_of(int bits) { return __int_as_float(bits); }
#else
SPLATREE_FN int bits_of(float x) { return __builtin_bit_cast(int, x); }
SPLATREE_FN float float_of(int bits) { return __builtin_bit_cast(float, bits); }
#endif

SPLATREE_FN float least(float x, float y) { return x < y ? x : y; }     // NaN in x gives y
SPLATREE_FN float greatest(float x, float y) { return x > y ? x : y; }  // NaN in x gives y

}  // namespace
}  // namespace splatree
