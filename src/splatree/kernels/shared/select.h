// Radius and footprint of one Gaussian for the selection; kernels/reference/select.py is the definition.
#pragma once
#include "shared/project.h"

namespace splatree {

// Which nodes are small, and which can be seen: what an options struct says, prepared for comparison.
struct SelectRule {
  float limit;                // a node is small if its size is at most this: (τ_R / 3)², px²; of balls τ_R, px
  float add, least_diagonal;  // the dilated diagonal is greatest(Σ'ii + add, least_diagonal), px²
  float floor;                // under the root of the eigenvalue, px⁴
  float pixel_error;          // τ_R, px
  float focal_max, focal_min;
  int sphere;              // whether the radius is that of the extent
  float ball;              // the share of its extent by which a node is nearer than its mean: 1 for balls, 0 for pixels
  float k_max, logit_min;  // footprint: reach of an opaque splat, σ; smallest logit opacity that can be seen
  float pad_x, pad_y;      // centre: how far out of the image it may be, px
};

enum ViewTest { FOOTPRINT, CENTRE, UNSEEN_TOO };

// The class of an inner row is the whole part of 8 log2 σ_mid + 128, held in 0 to 254. By interlacing, the larger eigenvalue of
// its splat is at least (σ_mid f / z)²: with M = J W = f/z (I | -u) in camera axes, M Mᵀ is at least (f/z)².
// The largest class also holds rows without a place: boxes pass over them, so no bound of a block says anything of them.
constexpr int LEAF_CLASS = 255, UNBOUNDED_CLASS = 254, CLASS_OF_UNIT = 128, CLASSES_PER_OCTAVE = 8;

// The view as planes in the world: the value of each at p is x p.x + y p.y + z p.z + d. The sides are the image's borders and
// the near plane. A splat of standard deviation s is out of view if the value of OUTSIDE + i at its mean is above reach[i] s for
// any side i; a mean whose values of INSIDE + i are all below 0 is in the image, half a pixel at least from its border. The
// value of DEPTH_PLANE is the view depth.
constexpr int NUM_SIDES = 5, OUTSIDE = 0, INSIDE = 5, DEPTH_PLANE = 10, NUM_PLANES = 12;

struct ViewPlanes {
  double x[NUM_PLANES], y[NUM_PLANES], z[NUM_PLANES], d[NUM_PLANES];  // the last one is zero: vectors are full
};

namespace {

struct Slopes {
  float x, y;  // of the view direction, held within the limits of the Jacobian
};

SPLATREE_FN Slopes clamped_slopes(const View& view, const Point& p) {
  const float inverse_z = 1.f / p.z;
  return {least(greatest(p.x * inverse_z, view.slope_min_x), view.slope_max_x),
          least(greatest(p.y * inverse_z, view.slope_min_y), view.slope_max_y)};
}

// The size of a node, which is small if this is at most the rule's limit: the larger eigenvalue of its splat, px². A node that is
// not beyond the near plane is refined by any finite limit, and so is one of NaN.
constexpr float LARGEST_SIZE = 3.4e38f;

SPLATREE_FN float size_of(const View& view, const SelectRule& rule, const Point& p, const Factor& m) {
  const float xx = dot(m.x, m.x), xy = dot(m.x, m.y), yy = dot(m.y, m.y);
  const float a = greatest(xx + rule.add, rule.least_diagonal), b = greatest(yy + rule.add, rule.least_diagonal);
  const float half_difference = 0.5f * (a - b);
  const float root = __builtin_sqrtf(greatest(half_difference * half_difference + xy * xy, rule.floor));
  const float eigenvalue = 0.5f * (a + b) + root;
  return ((p.z > view.near) & (eigenvalue < LARGEST_SIZE)) ? eigenvalue : LARGEST_SIZE;
}

// The same where the size is that of the extent: its radius on the image, px.
SPLATREE_FN float size_of_extent(const SelectRule& rule, const Point& p, float extent) {
  const float distance = __builtin_sqrtf(p.dx * p.dx + p.dy * p.dy + p.dz * p.dz) - rule.ball * extent;
  const float radius = rule.focal_max * extent / distance;
  return ((distance > 0) & (radius < LARGEST_SIZE)) ? radius : LARGEST_SIZE;
}

enum Answer { NO, YES, OPEN };

// Margin that keeps bounds apart from the rounding of the full computation.
constexpr float MARGIN = 1.0001f;

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
  return (x + slack_x >= 0.5f) & (x - slack_x <= view.width - 0.5f) & (y + slack_y >= 0.5f) & (y - slack_y <= view.height - 0.5f);
}

// Whether the footprint is in view, from centre, opacity and largest scale, where they tell.
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

SPLATREE_FN int is_visible(const View& view, const Point& p, const Factor& m, float logit) {
  const float log2_opacity = -log2_of(1.f + exp_of(-logit));
  const float k_squared = 1.38629436f * greatest(log2_opacity - view.log2_threshold, 0.f);  // 2 ln(o/τ)
  return meets_image(view, p, __builtin_sqrtf(k_squared * (dot(m.x, m.x) + view.dilation)),
                     __builtin_sqrtf(k_squared * (dot(m.y, m.y) + view.dilation)));
}

// The largest size class that a small inner row of a run can have, -1 if none can be small: R >= 3 σ_mid f / z, and so is
// that of the extent with the distance in place of z. Depth and distance are the largest of the run.
SPLATREE_FN int largest_small_class(const SelectRule& rule, bool all_small, double depth_max, double distance_max) {
  if (all_small) return LEAF_CLASS - 1;
  double scale;
  if (rule.sphere) {
    scale = rule.pixel_error * distance_max / (3.0 * rule.focal_max);
  } else {
    const double room = double(rule.limit) - rule.add;
    if (!(room > 0 && depth_max > 0)) return -1;
    scale = __builtin_sqrt(room) * depth_max / rule.focal_min;
  }
  const double size_class = CLASSES_PER_OCTAVE * __builtin_log2(scale * MARGIN) + CLASS_OF_UNIT;
  // Class 0 holds everything smaller too, so it can always be small; NaN and infinity exclude nothing.
  return size_class < 0 ? 0 : size_class < LEAF_CLASS - 1 ? int(size_class) : LEAF_CLASS - 1;
}

// The largest extent with which every row of a run is small by a limit, px: f e / (distance - ball e) <= limit from the nearest
// distance on. NEVER_SMALL where float32 may say otherwise of a row: distances whose squares it cannot hold, limits at which the
// distance is hardly more than the extent.
constexpr float NEVER_SMALL = -1.f;
constexpr double DISTANCE_LEAST = 1e-15, DISTANCE_MOST = 1e15, LIMIT_MOST = 16;  // of the focal length

SPLATREE_FN float surely_small_extent(const SelectRule& rule, float limit, double distance_min, double distance_max) {
  const bool is_certain =
      rule.sphere && distance_min > DISTANCE_LEAST && distance_max < DISTANCE_MOST && limit < LIMIT_MOST * rule.focal_max;
  return is_certain ? float(limit * distance_min / ((double(rule.focal_max) + double(rule.ball) * limit) * MARGIN)) : NEVER_SMALL;
}

}  // namespace
}  // namespace splatree
