// The pixels of a tile as warps take them, and splats as they meet them; what blend.cu and blend_backward.cu share.
#pragma once
#include "cuda/device.h"
#include "shared/constants.h"
#include "shared/ellipse.h"

namespace splatree {
namespace {

constexpr int WARP_WIDTH = 8, WARP_HEIGHT = 4;
constexpr float ALPHA_MAX = float(constants::ALPHA_MAX), ALPHA_THRESHOLD = float(constants::ALPHA_THRESHOLD);
constexpr float TRANSMITTANCE_MIN = float(constants::TRANSMITTANCE_MIN);
constexpr float SQRT_HALF_LOG2E = 0.849321800f;  // √(½ log2 e): exp(-½ q²) = 2^-(this q)²

// A splat as shared memory holds it, in units in which the exponent is a power of 2.
struct Brush {
  float4 geometry;    // x, y, a, b
  float4 appearance;  // c, log2 opacity, half size x, half size y
  float4 color;       // red, green, blue, depth
};

SPLATREE_FN Brush load_brush(const FrameJob* job, long long splat) {
  const float4 p = job->records[4 * splat], q = job->records[4 * splat + 1], r = job->records[4 * splat + 2];
  const float half_size_y = float4(job->records[4 * splat + 3]).x;
  return {make_float4(p.x, p.y, SQRT_HALF_LOG2E * p.z, SQRT_HALF_LOG2E * p.w),
          make_float4(SQRT_HALF_LOG2E * q.x, q.z, r.w, half_size_y), make_float4(q.w, r.x, r.y, r.z)};
}

// Whether a splat may touch the pixel centres of a rectangle of half size (half_x, half_y) around (x, y): |L d| over it is
// at least that at its centre less what the half sizes can add, and what float32 may lose.
SPLATREE_FN bool may_touch(const float4& g, const float4& s, float x, float y, float half_x, float half_y, float log2_threshold) {
  const float dx = x - g.x, dy = y - g.y, abs_b = __builtin_fabsf(g.w);
  const float u = g.z * dx + g.w * dy, v = s.x * dy;
  const float u_reach = g.z * half_x + abs_b * half_y + 2e-6f * (g.z * (s.z + 16) + abs_b * (s.w + 16));
  const float v_reach = s.x * half_y + 2e-6f * s.x * (s.w + 16);
  const float u_least = greatest(__builtin_fabsf(u) - u_reach, 0.f), v_least = greatest(__builtin_fabsf(v) - v_reach, 0.f);
  const float limit = (s.y - log2_threshold) * (1 + 1e-5f) + 1e-5f;
  return (u_least * u_least + v_least * v_least <= limit) & (__builtin_fabsf(dx) <= s.z * (1 + 1e-5f) + half_x + 1e-3f);
}

// The same for the pixels of a warp, whose corner is (x, y).
SPLATREE_FN bool may_touch_warp(const float4& g, const float4& s, float x, float y, float log2_threshold) {
  return may_touch(g, s, x + 0.5f * WARP_WIDTH, y + 0.5f * WARP_HEIGHT, 0.5f * (WARP_WIDTH - 1), 0.5f * (WARP_HEIGHT - 1),
                   log2_threshold);
}

}  // namespace
}  // namespace splatree
