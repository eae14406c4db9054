// Derivatives of one Gaussian from the sums of its splat; kernels/reference/backward.py is the definition.
#pragma once
#include "shared/constants.h"
#include "shared/project.h"

namespace splatree {
namespace {

struct Moments {
  float h, hu, hv, huu, huv, hvv;
};

// By the numbers of the projection: the centre, px, and the three numbers of Σ'.
struct SplatBackward {
  float x, y, xx, xy, yy;
};

template <bool ANTIALIASED>
SPLATREE_FN SplatBackward splat_backward_of(const View& view, const Moments& m, float factor_a, float factor_b, float factor_c,
                                            const Factor& f) {
  const float scale = 0.849321800f, two_ln2 = 1.38629436f;
  const float a = scale * factor_a, b = scale * factor_b, c = scale * factor_c;
  SplatBackward s;
  s.x = two_ln2 * (a * m.hu);
  s.y = two_ln2 * (b * m.hu + c * m.hv);
  const float half_square = 0.5f * two_ln2 * two_ln2;
  s.xx = half_square * (a * (a * m.huu));
  s.xy = 2.f * half_square * (a * (b * m.huu + c * m.huv));
  s.yy = half_square * (b * (b * m.huu + c * m.huv) + c * (b * m.huv + c * m.hvv));
  if (ANTIALIASED) {
    const float xx = dot(f.x, f.x), yy = dot(f.y, f.y), xy = dot(f.x, f.y);
    const Vector cross = {f.x.y * f.y.z - f.x.z * f.y.y, f.x.z * f.y.x - f.x.x * f.y.z, f.x.x * f.y.y - f.x.y * f.y.x};
    const float bare = dot(cross, cross) + 1e-30f;
    const float det = bare + view.dilation * (xx + yy) + view.dilation * view.dilation;
    s.xx += 0.5f * m.h * (yy / bare - (yy + view.dilation) / det);
    s.yy += 0.5f * m.h * (xx / bare - (xx + view.dilation) / det);
    s.xy += m.h * xy * (1.f / det - 1.f / bare);
  }
  return s;
}

struct GaussianBackward {
  Vector mean;  // without what the direction adds to it
  Vector log_scale;
  float quat[4];
};

// The columns of the rotation of a unit quaternion.
SPLATREE_FN void axes_of(float w, float x, float y, float z, Vector (&axes)[3]) {
  axes[0] = {1.f - 2.f * (y * y + z * z), 2.f * (x * y + w * z), 2.f * (x * z - w * y)};
  axes[1] = {2.f * (x * y - w * z), 1.f - 2.f * (x * x + z * z), 2.f * (y * z + w * x)};
  axes[2] = {2.f * (x * z + w * y), 2.f * (y * z - w * x), 1.f - 2.f * (x * x + y * y)};
}

SPLATREE_FN Vector sum_of(float p, Vector a, float q, Vector b) {
  return {p * a.x + q * b.x, p * a.y + q * b.y, p * a.z + q * b.z};
}

template <bool ANTIALIASED>
SPLATREE_FN GaussianBackward gaussian_backward_of(const View& view, const Point& p, const Vector log_scale, float qw, float qx,
                                                  float qy, float qz, const Moments& m, float factor_a, float factor_b,
                                                  float factor_c, float by_depth) {
  const Image image = image_of(view, p.x, p.y, p.z);
  const Vector scale = scale_of(view, p.z, log_scale);
  const float unit = power_of_two_over(
      greatest(greatest(__builtin_fabsf(qw), __builtin_fabsf(qx)), greatest(__builtin_fabsf(qy), __builtin_fabsf(qz))));
  const float square = qw * unit * (qw * unit) + qx * unit * (qx * unit) + qy * unit * (qy * unit) + qz * unit * (qz * unit);
  const bool turns = square > 0.f;
  const float inverse = turns ? unit / __builtin_sqrtf(square) : 0.f;
  const float w = turns ? qw * inverse : 1.f, x = qx * inverse, y = qy * inverse, z = qz * inverse;
  Vector axes[3];
  axes_of(w, x, y, z, axes);
  const Factor f = {row_of(image.tx, axes, scale), row_of(image.ty, axes, scale)};
  const SplatBackward s = splat_backward_of<ANTIALIASED>(view, m, factor_a, factor_b, factor_c, f);

  // By M, and from there by the scales, the axes and the rows of J W.
  const Vector by_mx = sum_of(2.f * s.xx, f.x, s.xy, f.y), by_my = sum_of(2.f * s.yy, f.y, s.xy, f.x);
  const Vector by_scale = {by_mx.x * f.x.x + by_my.x * f.y.x, by_mx.y * f.x.y + by_my.y * f.y.y,
                           by_mx.z * f.x.z + by_my.z * f.y.z};
  const float largest = view.sigma_max * p.z;
  const bool held_x = scale.x >= largest, held_y = scale.y >= largest, held_z = scale.z >= largest;
  GaussianBackward g;
  g.log_scale = {held_x ? 0.f : by_scale.x, held_y ? 0.f : by_scale.y, held_z ? 0.f : by_scale.z};
  const float held = (held_x ? by_scale.x : 0.f) + (held_y ? by_scale.y : 0.f) + (held_z ? by_scale.z : 0.f);
  const Vector sx = {scale.x * by_mx.x, scale.y * by_mx.y, scale.z * by_mx.z};
  const Vector sy = {scale.x * by_my.x, scale.y * by_my.y, scale.z * by_my.z};
  const Vector a0 = sum_of(sx.x, image.tx, sy.x, image.ty), a1 = sum_of(sx.y, image.tx, sy.y, image.ty);
  const Vector a2 = sum_of(sx.z, image.tx, sy.z, image.ty);
  const Vector by_tx = {sx.x * axes[0].x + sx.y * axes[1].x + sx.z * axes[2].x,
                        sx.x * axes[0].y + sx.y * axes[1].y + sx.z * axes[2].y,
                        sx.x * axes[0].z + sx.y * axes[1].z + sx.z * axes[2].z};
  const Vector by_ty = {sy.x * axes[0].x + sy.y * axes[1].x + sy.z * axes[2].x,
                        sy.x * axes[0].y + sy.y * axes[1].y + sy.z * axes[2].y,
                        sy.x * axes[0].z + sy.y * axes[1].z + sy.z * axes[2].z};

  // By the quaternion: across its own direction, for its length changes nothing.
  const float dw = 2.f * (z * (a0.y - a1.x) + y * (a2.x - a0.z) + x * (a1.z - a2.y));
  const float dx = 2.f * (y * (a0.y + a1.x) + z * (a0.z + a2.x) + w * (a1.z - a2.y) - 2.f * x * (a1.y + a2.z));
  const float dy = 2.f * (x * (a0.y + a1.x) + z * (a1.z + a2.y) + w * (a2.x - a0.z) - 2.f * y * (a0.x + a2.z));
  const float dz = 2.f * (x * (a0.z + a2.x) + y * (a1.z + a2.y) + w * (a0.y - a1.x) - 2.f * z * (a0.x + a1.y));
  const float along = w * dw + x * dx + y * dy + z * dz;
  g.quat[0] = inverse * (dw - w * along), g.quat[1] = inverse * (dx - x * along);
  g.quat[2] = inverse * (dy - y * along), g.quat[3] = inverse * (dz - z * along);

  // By the mean, in the axes of the camera and then of the world.
  const float* r = view.rotation;
  const float inverse_z = 1.f / p.z, slope_x = p.x * inverse_z, slope_y = p.y * inverse_z;
  const bool free_x = (slope_x >= view.slope_min_x) & (slope_x <= view.slope_max_x);
  const bool free_y = (slope_y >= view.slope_min_y) & (slope_y <= view.slope_max_y);
  const Vector depth_axis = {r[6], r[7], r[8]};
  const float ex = inverse_z * view.fx * (s.x - (free_x ? inverse_z * dot(by_tx, depth_axis) : 0.f));
  const float ey = inverse_z * view.fy * (s.y - (free_y ? inverse_z * dot(by_ty, depth_axis) : 0.f));
  const float ez = inverse_z * (held - ex * p.x - ey * p.y - dot(by_tx, image.tx) - dot(by_ty, image.ty)) + by_depth;
  g.mean = {r[0] * ex + r[3] * ey + r[6] * ez, r[1] * ex + r[4] * ey + r[7] * ez, r[2] * ex + r[5] * ey + r[8] * ez};
  return g;
}

// What a direction (x, y, z), of unit length, adds to the derivative by the mean: `along` are Σ_c ∂ sh_kc at along[k * stride].
SPLATREE_FN Vector direction_backward_of(float x, float y, float z, int degree, const float* along, int stride) {
  Vector d = {0.f, 0.f, 0.f};
  if (degree < 1) return d;
  const float c1 = float(constants::SH_C1);
  d = {-c1 * along[3 * stride], -c1 * along[stride], c1 * along[2 * stride]};
  if (degree >= 2) {
    const float p = float(constants::SH_C2_0) * along[4 * stride], q = float(constants::SH_C2_1) * along[5 * stride];
    const float s = float(constants::SH_C2_2) * along[6 * stride], t = float(constants::SH_C2_3) * along[7 * stride];
    const float u = float(constants::SH_C2_4) * along[8 * stride];
    d.x += p * y - 2.f * s * x + t * z + 2.f * u * x;
    d.y += p * x + q * z - 2.f * s * y - 2.f * u * y;
    d.z += q * y + 4.f * s * z + t * x;
  }
  if (degree >= 3) {
    const float xx = x * x, yy = y * y, zz = z * z;
    const float c0 = float(constants::SH_C3_0) * along[9 * stride], e1 = float(constants::SH_C3_1) * along[10 * stride];
    const float c2 = float(constants::SH_C3_2) * along[11 * stride], c3 = float(constants::SH_C3_3) * along[12 * stride];
    const float c4 = float(constants::SH_C3_4) * along[13 * stride], c5 = float(constants::SH_C3_5) * along[14 * stride];
    const float c6 = float(constants::SH_C3_6) * along[15 * stride];
    d.x += c0 * 6.f * x * y + e1 * y * z - c2 * 2.f * x * y - c3 * 6.f * x * z + c4 * (4.f * zz - 3.f * xx - yy) +
           c5 * 2.f * x * z + c6 * (3.f * xx - 3.f * yy);
    d.y += c0 * (3.f * xx - 3.f * yy) + e1 * x * z + c2 * (4.f * zz - xx - 3.f * yy) - c3 * 6.f * y * z - c4 * 2.f * x * y -
           c5 * 2.f * y * z - c6 * 6.f * x * y;
    d.z += e1 * x * y + c2 * 8.f * y * z + c3 * (6.f * zz - 3.f * xx - 3.f * yy) + c4 * 8.f * x * z + c5 * (xx - yy);
  }
  const float radial = d.x * x + d.y * y + d.z * z;
  return {d.x - radial * x, d.y - radial * y, d.z - radial * z};
}

}  // namespace
}  // namespace splatree
