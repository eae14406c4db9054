// Whether a row may touch the picture, from its mean and largest scale alone: a bound that spares the projection most rows out
// of view, before their quaternions, opacities and colours are read.
//
// Let X, Y, Z be the mean in camera axes, s its largest standard deviation. The box of the splat (shared/project.h) ends k σ_x
// from its centre with k² <= K² = 2 ln(1/τ) and σ_x² <= (f s/Z)² (1 + u²) + ε, where u is held within the limits l of the
// Jacobian. As √(p + q) <= √p + √q, it meets the columns of the picture, W px wide, only if
//
//     |f X + (c - W/2) Z| <= (W/2 - ½ + K √ε) Z + K f √(1 + l²) s
//
// which has no division and is one plane on the left; a row behind the eye fails it unless s is large. What float32 and the
// rotation of the camera (orthonormal within 1e-4) may lose, here and in the projection, is added on the right: 1e-3 of it, and
// 1e-5 of the coefficients times |d|, where the distance |d| of a row in view is itself bounded by Z and s. A row for which a
// comparison has no answer is kept.
#pragma once
#include "shared/project.h"

namespace splatree {
namespace {

struct Border {
  float x, y, z;               // the plane on the left, of the offset from the eye in world axes
  float per_depth, per_scale;  // of the right
};

struct InView {
  Border across, down;
};

SPLATREE_FN double larger(double x, double y) { return x > y ? x : y; }

SPLATREE_FN InView in_view_of(const View& view) {
  const double limit_x = larger(-view.slope_min_x, view.slope_max_x), limit_y = larger(-view.slope_min_y, view.slope_max_y);
  const double reach = __builtin_sqrt(1.38629436112 * larger(-view.log2_threshold, 0));
  const double blur = reach * __builtin_sqrt(double(view.dilation));
  // |d| of a row in view is at most this.
  const double distance_per_depth = 1 + limit_x + limit_y + blur / view.fx + blur / view.fy;
  const double distance_per_scale = reach * (2 + limit_x + limit_y);
  auto border_of = [&](const float* axis, double focal, double centre, double size, double limit) {
    const float* forward = view.rotation + 6;
    const double off = centre - 0.5 * size, lost = 1e-5 * (focal * (1 + limit) + __builtin_fabs(off) + blur);
    return Border{float(focal * axis[0] + off * forward[0]), float(focal * axis[1] + off * forward[1]),
                  float(focal * axis[2] + off * forward[2]),
                  float(1.001 * (0.5 * size - 0.5 + blur + 0.01) + lost * distance_per_depth),
                  float(1.001 * reach * focal * __builtin_sqrt(1 + limit * limit) + lost * distance_per_scale)};
  };
  return {border_of(view.rotation, view.fx, view.cx, view.width, limit_x),
          border_of(view.rotation + 3, view.fy, view.cy, view.height, limit_y)};
}

// Whether the offset (x, y, z) lies beyond the border for its depth and scale.
SPLATREE_FN int is_beyond(const Border& border, float x, float y, float z, float depth, float scale) {
  const float value = border.x * x + border.y * y + border.z * z;
  return __builtin_fabsf(value) > border.per_depth * depth + border.per_scale * scale;
}

SPLATREE_FN int may_be_seen(const View& view, const InView& bound, Vector mean, Vector log_scale) {
  const float x = (mean.x - view.center_high[0]) - view.center_low[0];
  const float y = (mean.y - view.center_high[1]) - view.center_low[1];
  const float z = (mean.z - view.center_high[2]) - view.center_low[2];
  const float depth = view.rotation[6] * x + view.rotation[7] * y + view.rotation[8] * z;
  // NaN counts as the smallest scale, as in the projection.
  const float scale = exp_of(greatest(log_scale.z, greatest(log_scale.y, greatest(log_scale.x, -126.f))));
  return 1 - (is_beyond(bound.across, x, y, z, depth, scale) | is_beyond(bound.down, x, y, z, depth, scale));
}

}  // namespace
}  // namespace splatree
