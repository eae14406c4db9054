// Four floats and the transposition of four of them: the step between rows in memory and planes in registers.
#pragma once

namespace splatree {
namespace {

typedef float Quad __attribute__((vector_size(16)));
typedef float LooseQuad __attribute__((vector_size(16), aligned(4), may_alias));

#ifdef __clang__
#define SPLATREE_SHUFFLE(a, b, ...) __builtin_shufflevector(a, b, __VA_ARGS__)
#else
typedef int QuadIndex __attribute__((vector_size(16)));
#define SPLATREE_SHUFFLE(a, b, ...) __builtin_shuffle(a, b, QuadIndex{__VA_ARGS__})
#endif

inline Quad load_quad(const float* p) { return *reinterpret_cast<const LooseQuad*>(p); }
inline void store_quad(float* p, Quad q) { *reinterpret_cast<LooseQuad*>(p) = q; }

// Rows to columns of a 4 × 4 matrix.
inline void transpose(Quad& a, Quad& b, Quad& c, Quad& d) {
  const Quad ab_low = SPLATREE_SHUFFLE(a, b, 0, 4, 1, 5), ab_high = SPLATREE_SHUFFLE(a, b, 2, 6, 3, 7);
  const Quad cd_low = SPLATREE_SHUFFLE(c, d, 0, 4, 1, 5), cd_high = SPLATREE_SHUFFLE(c, d, 2, 6, 3, 7);
  a = SPLATREE_SHUFFLE(ab_low, cd_low, 0, 1, 4, 5);
  b = SPLATREE_SHUFFLE(ab_low, cd_low, 2, 3, 6, 7);
  c = SPLATREE_SHUFFLE(ab_high, cd_high, 0, 1, 4, 5);
  d = SPLATREE_SHUFFLE(ab_high, cd_high, 2, 3, 6, 7);
}

}  // namespace
}  // namespace splatree
