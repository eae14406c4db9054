// Splats along an axis, from either end: what of each is seen, and what it leaves of the light (reference/visibility.py).
//
// A splat is evaluated in the cells of its box, a row of eight cells at a time. Cost: about 20 ns a block of eight.
#include "cpu/build/visibility.h"
#include "cpu/runtime/isa.h"
#include "shared/elementary.h"

namespace splatree::SPLATREE_ISA {
namespace {

constexpr float LEAST_POWER = -2;  // a splat ends at 2 σ

SPLATREE_FN int64_t cell_of(float x) { return static_cast<int64_t>(__builtin_floorf(x)); }

}  // namespace

void see_through(const SightJob& job) {
  const int64_t stride = job.width + SIGHT_MARGIN, mask = job.width - 1;
  for (int64_t i = 0; i < job.count; ++i) {
    Sighted& s = job.splats[job.backwards ? job.count - 1 - i : i];
    const int64_t first_u = cell_of(s.u - s.half_u), last_u = cell_of(s.u + s.half_u);
    const int64_t first_v = cell_of(s.v - s.half_v), last_v = cell_of(s.v + s.half_v);
    const int64_t blocks = (last_u - first_u) / SIGHT_LANES + 1;
    const float a = -0.5f * s.a, c = -0.5f * s.c, opacity = s.opacity, depth = s.depth, inverse_reach = job.inverse_reach;
    float seen[SIGHT_LANES] = {}, shown[SIGHT_LANES] = {};
    for (int64_t v = first_v; v <= last_v; ++v) {
      const float dv = static_cast<float>(v) + 0.5f - s.v, b = -s.b * dv, rest = c * dv * dv;
      const int64_t row = (v & mask) * stride + (first_u & mask);
      for (int64_t block = 0; block < blocks; ++block) {
        const float first = static_cast<float>(first_u + block * SIGHT_LANES) + 0.5f - s.u;
        float* passing = job.passing + row + block * SIGHT_LANES;
        float* depths = job.depths + row + block * SIGHT_LANES;
#pragma omp simd
        for (int l = 0; l < SIGHT_LANES; ++l) {
          const float du = first + static_cast<float>(l);
          const float power = (a * du + b) * du + rest;
          const bool inside = power >= LEAST_POWER;
          const float g = inside ? exp_of(power) : 0.f;
          const float hidden = (1.f - passing[l]) * exp_of(-__builtin_fabsf(depth - depths[l]) * inverse_reach);
          seen[l] += g * (1.f - hidden);
          shown[l] += g;
          passing[l] = inside ? (1.f - hidden) * (1.f - opacity * g) : passing[l];
          depths[l] = inside ? depth : depths[l];
        }
      }
    }
    float all_seen = 0, all_shown = 0;
    for (int l = 0; l < SIGHT_LANES; ++l) all_seen += seen[l], all_shown += shown[l];
    const float share = all_shown > 0.f ? all_seen / all_shown : 1.f;
    s.sum += share * share;
  }
}

}  // namespace splatree::SPLATREE_ISA
