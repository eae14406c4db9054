// What the shared maths needs from its surroundings: these headers are pure functions of scalars without branches, so that a
// compiler turns a loop over lanes that calls them into vector code.
#pragma once

#define SPLATREE_FN static inline __attribute__((always_inline))

namespace splatree {
namespace {

SPLATREE_FN int bits_of(float x) { return __builtin_bit_cast(int, x); }
SPLATREE_FN float float_of(int bits) { return __builtin_bit_cast(float, bits); }

SPLATREE_FN float least(float x, float y) { return x < y ? x : y; }     // NaN in x gives y
SPLATREE_FN float greatest(float x, float y) { return x > y ? x : y; }  // NaN in x gives y

}  // namespace
}  // namespace splatree
