// Radius and footprint of one Gaussian for the selection; kernels/reference/select.py is the definition.
#pragma once
#include "shared/project.h"

namespace splatree {

// Which nodes are small, and which can be seen: what an options struct says, prepared for comparison.
struct SelectRule {
  float limit;              // (τ_R / 3)²: a node is small if the larger eigenvalue of its splat is at most this, px²
  float add, least_diagonal;  // the dilated diagonal is greatest(Σ'ii + add, least_diagonal), px²
  float floor;              // under the root of the eigenvalue, px⁴
  float pixel_error;        // τ_R, px
  float focal_max, focal_min;
  int sphere;               // whether the radius is that of the ball
  float k_max, logit_min;   // footprint: reach of an opaque splat, σ; smallest logit opacity that can be seen
  float pad_x, pad_y;       // centre: how far out of the image it may be, px
};

namespace {

// Σ' without dilation: the entries 00, 01, 11, px².
struct Covariance {
  float xx, xy, yy;
};

struct Slopes {
  float x, y;  // of the view direction, held within the limits of the Jacobian
};

SPLATREE_FN Slopes clamped_slopes(const View& view, const Point& p) {
  const float inverse_z = 1.f / p.z;
  return {least(greatest(p.x * inverse_z, view.slope_min_x), view.slope_max_x),
          least(greatest(p.y * inverse_z, view.slope_min_y), view.slope_max_y)};
}

SPLATREE_FN Covariance covariance_of(const Factor& m) { return {dot(m.x, m.x), dot(m.x, m.y), dot(m.y, m.y)}; }

// Whether R <= τ_R. A comparison with NaN is false: such a node is refined, and so is one not beyond the near plane.
SPLATREE_FN int is_small(const View& view, const SelectRule& rule, const Point& p, const Covariance& c) {
  const float a = greatest(c.xx + rule.add, rule.least_diagonal), b = greatest(c.yy + rule.add, rule.least_diagonal);
  const float half_difference = 0.5f * (a - b);
  const float root = __builtin_sqrtf(greatest(half_difference * half_difference + c.xy * c.xy, rule.floor));
  return (p.z > view.near) & (0.5f * (a + b) + root <= rule.limit);
}

SPLATREE_FN int is_small_ball(const SelectRule& rule, const Point& p, float extent) {
  const float distance = __builtin_sqrtf(p.dx * p.dx + p.dy * p.dy + p.dz * p.dz) - extent;
  return (distance > 0) & (rule.focal_max * extent <= rule.pixel_error * distance);
}

enum Answer { NO, YES, OPEN };

// Margin that keeps the bounds below apart from the rounding of the full computation.
constexpr float MARGIN = 1.0001f;

// is_small from the scales alone, where they tell. With M = J W = f/z (I | -u) in camera axes, M Mᵀ lies between (f/z)² and
// (f/z)² (1 + |u|²), so by interlacing σ_mid² (f_min/z)² <= λ(Σ') <= σ_max² (f_max/z)² (1 + |u|²). What dilation and floor
// add to the eigenvalue lies between 0 and add + least_diagonal + √floor.
SPLATREE_FN int is_small_bound(const View& view, const SelectRule& rule, const Point& p, Vector log_scale) {
  const float x = log_scale.x, y = log_scale.y, z = log_scale.z;
  const float low = least(x, y), high = greatest(x, y);
  const float largest = exp_of(greatest(high, z)), middle = exp_of(greatest(low, least(high, z)));
  const float inverse_z = 1.f / p.z;
  const Slopes u = clamped_slopes(view, p);
  const float above = largest * rule.focal_max * inverse_z, below = middle * rule.focal_min * inverse_z;
  const float upper = above * above * (1.f + u.x * u.x + u.y * u.y) + rule.add + rule.least_diagonal +
                      __builtin_sqrtf(rule.floor);
  const float lower = below * below + rule.add;
  const int near = !(p.z > view.near);
  const int small = !near & (upper * MARGIN <= rule.limit);
  const int large = near | (lower > rule.limit * MARGIN);
  return small ? YES : large ? NO : OPEN;
}

// Whether the centre is in the image enlarged by the pad.
SPLATREE_FN int is_centred(const View& view, const SelectRule& rule, const Point& p) {
  const float inverse_z = 1.f / p.z;
  const float x = view.fx * (p.x * inverse_z) + view.cx, y = view.fy * (p.y * inverse_z) + view.cy;
  return (p.z > view.near) & (x >= -rule.pad_x) & (x <= view.width + rule.pad_x) & (y >= -rule.pad_y) &
         (y <= view.height + rule.pad_y);
}

// Whether the box of half size (reach_x, reach_y) holds the row and the column of a pixel centre, within 0.01 px and
// 0.1 %: nothing that the projection draws is lost to rounding.
SPLATREE_FN int meets_image(const View& view, const Point& p, float reach_x, float reach_y) {
  const float inverse_z = 1.f / p.z;
  const float x = view.fx * (p.x * inverse_z) + view.cx, y = view.fy * (p.y * inverse_z) + view.cy;
  const float slack_x = 1.001f * reach_x + 0.01f, slack_y = 1.001f * reach_y + 0.01f;
  return (x + slack_x >= 0.5f) & (x - slack_x <= view.width - 0.5f) & (y + slack_y >= 0.5f) &
         (y - slack_y <= view.height - 0.5f);
}

// Visibility of the footprint from centre, opacity and largest scale, where they tell.
SPLATREE_FN int is_visible_bound(const View& view, const SelectRule& rule, const Point& p, Vector log_scale, float logit) {
  const float largest = exp_of(greatest(greatest(log_scale.x, log_scale.y), log_scale.z));
  const float inverse_z = 1.f / p.z;
  const Slopes u = clamped_slopes(view, p);
  const float scale = largest * inverse_z;
  const float sx = view.fx * scale, sy = view.fy * scale;
  const float reach_x = rule.k_max * __builtin_sqrtf(sx * sx * (1.f + u.x * u.x) + view.dilation);
  const float reach_y = rule.k_max * __builtin_sqrtf(sy * sy * (1.f + u.y * u.y) + view.dilation);
  const int possible = (p.z > view.near) & (logit >= rule.logit_min);
  const int outside = !meets_image(view, p, reach_x, reach_y);
  const int inside = meets_image(view, p, 0.f, 0.f);
  return (1 - possible) | outside ? NO : inside ? YES : OPEN;
}

SPLATREE_FN int is_visible(const View& view, const Point& p, const Covariance& c, float logit) {
  const float log2_opacity = -log2_of(1.f + exp_of(-logit));
  const float k_squared = 1.38629436f * greatest(log2_opacity - view.log2_threshold, 0.f);  // 2 ln(o/τ)
  return meets_image(view, p, __builtin_sqrtf(k_squared * (c.xx + view.dilation)),
                     __builtin_sqrtf(k_squared * (c.yy + view.dilation)));
}

}  // namespace
}  // namespace splatree
