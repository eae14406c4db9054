// The projection of one Gaussian; kernels/reference/project.py is the definition.
#pragma once
#include "shared/constants.h"
#include "shared/elementary.h"
#include "shared/square.h"

namespace splatree {

struct View {
  float rotation[9];                    // camera from world, row by row
  float center_high[3], center_low[3];  // the eye in the world: two floats each, so that map coordinates keep their precision
  float fx, fy, cx, cy;                 // px
  float width, height, near;
  float slope_min_x, slope_max_x, slope_min_y, slope_max_y;  // limits of x/z, y/z in the Jacobian
  float dilation;                                            // px^2
  float sigma_max;                                           // largest standard deviation over z, world units
  float least_opacity, log2_threshold;                       // of a splat; at the edge of its box
  int antialiased;
};

namespace {

struct Point {
  float dx, dy, dz;  // from the eye, world axes
  float x, y, z;     // camera axes
};

SPLATREE_FN Point point_of(const View& view, float mean_x, float mean_y, float mean_z) {
  Point p;
  p.dx = (mean_x - view.center_high[0]) - view.center_low[0];
  p.dy = (mean_y - view.center_high[1]) - view.center_low[1];
  p.dz = (mean_z - view.center_high[2]) - view.center_low[2];
  const float* r = view.rotation;
  p.x = r[0] * p.dx + r[1] * p.dy + r[2] * p.dz;
  p.y = r[3] * p.dx + r[4] * p.dy + r[5] * p.dz;
  p.z = r[6] * p.dx + r[7] * p.dy + r[8] * p.dz;
  return p;
}

struct Vector {
  float x, y, z;
};

SPLATREE_FN float dot(Vector p, Vector q) { return p.x * q.x + p.y * q.y + p.z * q.z; }

// The standard deviations, world units.
SPLATREE_FN Vector scale_of(const View& view, float z, Vector log_scale) {
  const float largest = view.sigma_max * z;
  return {least(exp_of(log_scale.x), largest), least(exp_of(log_scale.y), largest), least(exp_of(log_scale.z), largest)};
}

// How an inner node follows the pixel that it is drawn at; kernels/reference/project.py: follow.
struct Curve {
  float bare, far, peak, dilation;  // peak 0: a row that is drawn as stored
};

struct Followed {
  Vector scale;
  float opacity;
};

SPLATREE_FN float area_of(Vector variance, float dilation) {
  const float x = __builtin_sqrtf(variance.x + dilation), y = __builtin_sqrtf(variance.y + dilation);
  const float z = __builtin_sqrtf(variance.z + dilation);
  return greatest((x * y + y * z + x * z) * 0.333333333f, 1e-37f);
}

// How much wider variances are for a mass beyond one Gaussian.
SPLATREE_FN float widening_of(float mass) {
  return exp2_of(0.3f * log2_of(greatest(mass * float(1 / constants::ALPHA_MAX), 1.f)));
}

SPLATREE_FN Followed followed_of(const Curve& c, float dilation, Vector scale, float sigmoid) {
  const float stored = widening_of(c.peak), added = (stored - 1.f) * c.dilation;
  const Vector v = {greatest((scale.x * scale.x - added) / stored, 0.f), greatest((scale.y * scale.y - added) / stored, 0.f),
                    greatest((scale.z * scale.z - added) / stored, 0.f)};
  const float h = least(dilation, c.dilation), far = c.far * h, at_level = c.far * c.dilation;
  const float most = c.peak * area_of(v, c.dilation);
  const float slope = greatest(most * most - c.bare * c.bare - at_level * at_level, 0.f) / greatest(c.dilation, 1e-37f);
  const float mass = least(__builtin_sqrtf(c.bare * c.bare + slope * h + far * far) / area_of(v, h), c.peak);
  const float wide = widening_of(mass), more = (wide - 1.f) * h;
  const bool follows = c.peak > 0.f;
  return {{follows ? __builtin_sqrtf(wide * v.x + more) : scale.x, follows ? __builtin_sqrtf(wide * v.y + more) : scale.y,
           follows ? __builtin_sqrtf(wide * v.z + more) : scale.z},
          follows ? least(mass, float(constants::ALPHA_MAX)) : sigmoid};
}

// The centre in the picture, px, and the rows of J W: f/z (w_axis - u w_depth), px per world unit.
struct Image {
  float x, y;
  Vector tx, ty;
};

SPLATREE_FN Image image_of(const View& view, float x, float y, float z) {
  const float inverse_z = 1.f / z;
  const float slope_x = x * inverse_z, slope_y = y * inverse_z;
  const float ux = least(greatest(slope_x, view.slope_min_x), view.slope_max_x);
  const float uy = least(greatest(slope_y, view.slope_min_y), view.slope_max_y);
  const float gx = view.fx * inverse_z, gy = view.fy * inverse_z;
  const float* r = view.rotation;
  return {view.fx * slope_x + view.cx,
          view.fy * slope_y + view.cy,
          {gx * (r[0] - ux * r[6]), gx * (r[1] - ux * r[7]), gx * (r[2] - ux * r[8])},
          {gy * (r[3] - uy * r[6]), gy * (r[4] - uy * r[7]), gy * (r[5] - uy * r[8])}};
}

// A row t of J W times R S.
SPLATREE_FN Vector row_of(Vector t, const Vector (&axes)[3], Vector scale) {
  return {dot(t, axes[0]) * scale.x, dot(t, axes[1]) * scale.y, dot(t, axes[2]) * scale.z};
}

// The two rows of M = J W R S, px.
struct Factor {
  Vector x, y;
};

SPLATREE_FN Factor factor_of(Vector tx, Vector ty, float qw, float qx, float qy, float qz, Vector scale) {
  // Columns of the rotation of a quaternion of any length, which is first scaled by a power of two against overflow.
  const float unit = power_of_two_over(
      greatest(greatest(__builtin_fabsf(qw), __builtin_fabsf(qx)), greatest(__builtin_fabsf(qy), __builtin_fabsf(qz))));
  const float w = qw * unit, x = qx * unit, y = qy * unit, z = qz * unit;
  const float s = 2.f / greatest(w * w + x * x + y * y + z * z, 1e-37f);
  const Vector axes[3] = {
      {1.f - s * (y * y + z * z), s * (x * y + w * z), s * (x * z - w * y)},
      {s * (x * y - w * z), 1.f - s * (x * x + z * z), s * (y * z + w * x)},
      {s * (x * z + w * y), s * (y * z - w * x), 1.f - s * (x * x + y * y)},
  };
  return {row_of(tx, axes, scale), row_of(ty, axes, scale)};
}

SPLATREE_FN Factor factor_of(const View& view, const Point& p, float qw, float qx, float qy, float qz, Vector log_scale) {
  const Image image = image_of(view, p.x, p.y, p.z);
  return factor_of(image.tx, image.ty, qw, qx, qy, qz, scale_of(view, p.z, log_scale));
}

struct Splat {
  float a, b, c, opacity, log2_opacity, half_size_x, half_size_y;
  int visible;
};

// Of the centre (x, y) in the picture, the depth z, the rows of M, and the opacity as stored.
template <bool ANTIALIASED, bool SQUARE>
SPLATREE_FN Splat splat_of(const View& view, const Square& square, float x, float y, float z, Vector mx, Vector my,
                           float sigmoid) {
  // The determinant as a sum of positive terms.
  const float mxx = dot(mx, mx), myy = dot(my, my), xy = dot(mx, my);
  const Vector cross = {mx.y * my.z - mx.z * my.y, mx.z * my.x - mx.x * my.z, mx.x * my.y - mx.y * my.x};
  const float undilated_det = dot(cross, cross);
  const float det = undilated_det + view.dilation * (mxx + myy) + view.dilation * view.dilation;
  const float xx = mxx + view.dilation, yy = myy + view.dilation;

  Splat splat;
  splat.opacity = ANTIALIASED ? sigmoid * __builtin_sqrtf(undilated_det / det) : sigmoid;
  splat.log2_opacity = log2_of(greatest(splat.opacity, 1e-37f));
  const float k = __builtin_sqrtf(1.38629436f * greatest(splat.log2_opacity - view.log2_threshold, 0.f));  // √(2 ln(o/τ))
  const float sigma_x = __builtin_sqrtf(xx), sigma_y = __builtin_sqrtf(yy), root_det = __builtin_sqrtf(det);
  splat.half_size_x = k * sigma_x;
  splat.half_size_y = k * sigma_y;
  // a = σ_y / √det, b = -a xy / yy, c = 1 / σ_y
  const float inverse = 1.f / (sigma_y * root_det);
  splat.c = root_det * inverse;
  splat.a = yy * inverse;
  splat.b = -xy * inverse;
  // NaN anywhere makes a comparison false: such a row is not drawn.
  splat.visible = (z > view.near) & (splat.opacity >= view.least_opacity);
  if (SQUARE) {
    const float half_side = half_side_of(square, xx, xy, yy, splat.log2_opacity);
    const Side across = side_of(x, half_side, tiles_along(view.width));
    const Side down = side_of(y, half_side, tiles_along(view.height));
    splat.visible &= (across.first < across.end) & (down.first < down.end);
  } else {
    splat.visible &= (x + splat.half_size_x >= 0.5f) & (x - splat.half_size_x <= view.width - 0.5f) &
                     (y + splat.half_size_y >= 0.5f) & (y - splat.half_size_y <= view.height - 0.5f);
  }
  return splat;
}

}  // namespace
}  // namespace splatree
