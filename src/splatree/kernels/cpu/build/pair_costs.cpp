// What merging a Gaussian with each of up to eight others changes in the picture (reference/pairs.py has the equations): the
// candidates are the lanes of a vector. Cost: about ten exponentials and square roots a candidate, in lanes.
#include "cpu/build/pairs.h"
#include "shared/constants.h"
#include "shared/elementary.h"

namespace splatree::SPLATREE_ISA {
namespace {

constexpr int LANES = PAIR_NEIGHBORS;

// A covariance seen along an axis of the world: [[a, b], [b, c]].
struct Plane {
  float a, b, c;
};

SPLATREE_FN float determinant(Plane s) { return greatest(s.a * s.c - s.b * s.b, 1e-6f * s.a * s.c); }

// ∫ G₁ G₂ over the plane, divided by π, at offset (u, v).
SPLATREE_FN float overlap(Plane s, float det_s, Plane t, float det_t, float u, float v) {
  const Plane sum{s.a + t.a, s.b + t.b, s.c + t.c};
  const float inverse = 1.f / determinant(sum);
  const float distance2 = (sum.c * u * u - 2.f * sum.b * u * v + sum.a * v * v) * inverse;
  return 2.f * __builtin_sqrtf(det_s * det_t * inverse) * exp_of(-0.5f * greatest(distance2, 0.f));
}

// The overlaps in a plane of this Gaussian p, the other q and the merged m; (u, v) leads from p to q, m has gone the share of it.
struct Overlaps {
  float pq, pm, qm, mm;
};

SPLATREE_FN Overlaps overlaps_in(Plane p, Plane q, Plane m, float share, float u, float v) {
  const float det_p = determinant(p), det_q = determinant(q), det_m = determinant(m), rest = 1.f - share;
  return {overlap(p, det_p, q, det_q, u, v), overlap(p, det_p, m, det_m, share * u, share * v),
          overlap(q, det_q, m, det_m, rest * u, rest * v), __builtin_sqrtf(det_m)};
}

// The cost of each candidate, and the opacity that costs least.
SPLATREE_FN void cost_in_lanes(const PairCandidates& pair, float* __restrict costs, float* __restrict opacities) {
  const PairRecord& p = *pair.self;
  const float length = __builtin_sqrtf(p.covariance[0] + p.covariance[3] + p.covariance[5]);  // the unit of all lengths
  const float unit = 1.f / length, unit2 = unit * unit;
  alignas(64) float d[3][LANES], s[6][LANES], color[3][LANES], opacity[LANES], weight[LANES], energy[LANES], visibility[LANES];
  for (int l = 0; l < LANES; ++l) {
    const PairRecord& q = *pair.others[l];
    for (int a = 0; a < 3; ++a) d[a][l] = (q.mean[a] - p.mean[a]) * unit;
    for (int a = 0; a < 6; ++a) s[a][l] = q.covariance[a] * unit2;
    for (int a = 0; a < 3; ++a) color[a][l] = q.color[a];
    opacity[l] = q.opacity, weight[l] = q.weight, energy[l] = q.energy, visibility[l] = q.visibility;
  }
  float own[6];
  for (int a = 0; a < 6; ++a) own[a] = p.covariance[a] * unit2;
  const float r = p.color[0], g = p.color[1], b = p.color[2];

#pragma omp simd
  for (int l = 0; l < LANES; ++l) {
    const float share = weight[l] / (weight[l] + p.weight), rest = 1.f - share;  // of the other, of this one
    const float x = d[0][l], y = d[1][l], z = d[2][l], spread = share * rest;
    const float xx = rest * own[0] + share * s[0][l] + spread * x * x, xy = rest * own[1] + share * s[1][l] + spread * x * y,
                xz = rest * own[2] + share * s[2][l] + spread * x * z, yy = rest * own[3] + share * s[3][l] + spread * y * y,
                yz = rest * own[4] + share * s[4][l] + spread * y * z, zz = rest * own[5] + share * s[5][l] + spread * z * z;
    const Overlaps front = overlaps_in({own[0], own[1], own[3]}, {s[0][l], s[1][l], s[3][l]}, {xx, xy, yy}, share, x, y);
    const Overlaps top = overlaps_in({own[0], own[2], own[5]}, {s[0][l], s[2][l], s[5][l]}, {xx, xz, zz}, share, x, z);
    const Overlaps side = overlaps_in({own[3], own[4], own[5]}, {s[3][l], s[4][l], s[5][l]}, {yy, yz, zz}, share, y, z);
    const float pq = front.pq + top.pq + side.pq, pm = front.pm + top.pm + side.pm, qm = front.qm + top.qm + side.qm,
                mm = front.mm + top.mm + side.mm;

    // Products of (colour, 1) with (colour, 1).
    const float r2 = color[0][l], g2 = color[1][l], b2 = color[2][l];
    const float rm = rest * r + share * r2, gm = rest * g + share * g2, bm = rest * b + share * b2;
    const float of_pair = (p.energy + energy[l]) * unit2 + 2.f * p.opacity * opacity[l] * (1.f + r * r2 + g * g2 + b * b2) * pq;
    const float in_common =
        p.opacity * (1.f + r * rm + g * gm + b * bm) * pm + opacity[l] * (1.f + r2 * rm + g2 * gm + b2 * bm) * qm;
    const float of_one = (1.f + rm * rm + gm * gm + bm * bm) * mm;
    const float visible = rest * p.visibility + share * visibility[l];
    const float best = least(greatest(in_common / of_one, 1e-4f * visible), float(constants::MERGED_ALPHA_MAX) * visible);
    opacities[l] = best / visible;
    // Sizes that differ more than the squares of float32 have no cost: they are merged last.
    costs[l] = least((of_pair - 2.f * best * in_common + best * best * of_one) * (length * length), 3e38f);
  }
}

}  // namespace

void costs_of_pairs(const PairCandidates& pair, float* costs) {
  alignas(64) float opacities[LANES];
  cost_in_lanes(pair, costs, opacities);
}

PairCost cheapest_pair(const PairCandidates& pair) {
  alignas(64) float costs[LANES], opacities[LANES];
  cost_in_lanes(pair, costs, opacities);
  PairCost cheapest{0, costs[0], opacities[0]};
  for (int l = 1; l < pair.count; ++l)
    if (costs[l] < cheapest.cost) cheapest = {l, costs[l], opacities[l]};
  return cheapest;
}

}  // namespace splatree::SPLATREE_ISA
