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

// Three floats and a zero.
inline Quad load_triple(const float* p) {
  typedef double Pair __attribute__((vector_size(16)));
  double low;
  __builtin_memcpy(&low, p, sizeof low);
  Quad q = reinterpret_cast<Quad>(Pair{low, 0.});
  q[2] = p[2];
  return q;
}

// Rows to columns of a 4 × 4 matrix.
inline void transpose(Quad& a, Quad& b, Quad& c, Quad& d) {
  const Quad ab_low = SPLATREE_SHUFFLE(a, b, 0, 4, 1, 5), ab_high = SPLATREE_SHUFFLE(a, b, 2, 6, 3, 7);
  const Quad cd_low = SPLATREE_SHUFFLE(c, d, 0, 4, 1, 5), cd_high = SPLATREE_SHUFFLE(c, d, 2, 6, 3, 7);
  a = SPLATREE_SHUFFLE(ab_low, cd_low, 0, 1, 4, 5);
  b = SPLATREE_SHUFFLE(ab_low, cd_low, 2, 3, 6, 7);
  c = SPLATREE_SHUFFLE(ab_high, cd_high, 0, 1, 4, 5);
  d = SPLATREE_SHUFFLE(ab_high, cd_high, 2, 3, 6, 7);
}

// Four rows of three floats, which follow each other, to three columns.
inline void transpose_triples(Quad& a, Quad& b, Quad& c) {
  const Quad xy = SPLATREE_SHUFFLE(b, c, 2, 3, 5, 6), yz = SPLATREE_SHUFFLE(a, b, 1, 2, 4, 5);
  a = SPLATREE_SHUFFLE(a, xy, 0, 3, 4, 6);
  b = SPLATREE_SHUFFLE(yz, xy, 0, 2, 5, 7);
  c = SPLATREE_SHUFFLE(yz, c, 1, 3, 4, 7);
}

// The reverse: three columns to four rows of three floats.
inline void interleave_triples(Quad& a, Quad& b, Quad& c) {
  const Quad ab_low = SPLATREE_SHUFFLE(a, b, 0, 4, 1, 5), ab_high = SPLATREE_SHUFFLE(a, b, 2, 6, 3, 7);
  const Quad bc = SPLATREE_SHUFFLE(b, c, 1, 5, 1, 5);
  a = SPLATREE_SHUFFLE(ab_low, c, 0, 1, 4, 2);
  b = SPLATREE_SHUFFLE(bc, ab_high, 0, 1, 4, 5);
  c = SPLATREE_SHUFFLE(c, ab_high, 2, 6, 7, 3);
}

}  // namespace
}  // namespace splatree
