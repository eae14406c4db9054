// Projection and colour of the selected rows; kernels/reference/project.py is the definition.
//
// project   a thread a row. Splat i comes from the i-th selected row, so the order of splats does not depend on the schedule; one
//           that does not touch the image gets a key behind all depths and no tiles.
#include "cuda/rows.h"
#include "shared/harmonics.h"
#include "shared/record.h"

namespace splatree {
namespace {

constexpr int MAX_COEFFICIENTS = 16;

// Σ Y_k(d) sh_k + ½, not below 0. Four coefficients of three channels are read as three vectors of four floats, where rows begin
// at a multiple of 16 bytes: with the harmonics of degree 1 and 3.
template <int DEGREE>
SPLATREE_FN Vector color_of(const FrameJob* job, const Point& p, long long row) {
  constexpr int COUNT = (DEGREE + 1) * (DEGREE + 1);
  const float inverse = 1.f / __builtin_sqrtf(p.dx * p.dx + p.dy * p.dy + p.dz * p.dz);
  float basis[MAX_COEFFICIENTS];
  harmonics_of(p.dx * inverse, p.dy * inverse, p.dz * inverse, DEGREE, basis, 1);
  const long long first = row * job->num_coefficients * 3;
  const bool in_fours = job->num_coefficients % 4 == 0;
  float color[3] = {0.5f, 0.5f, 0.5f};
#pragma unroll
  for (int k = 0; k < COUNT; k += 4) {
    const int count = COUNT - k < 4 ? COUNT - k : 4;
    float sh[12];
    if (in_fours && count == 4)
      for (int i = 0; i < 12; i += 4) {
        const float4 four = load_four(job->sh, first + 3 * k + i);
        sh[i] = four.x, sh[i + 1] = four.y, sh[i + 2] = four.z, sh[i + 3] = four.w;
      }
    else
      for (int i = 0; i < 3 * count; ++i) sh[i] = job->sh[first + 3 * k + i];
    for (int i = 0; i < 3 * count; ++i) color[i % 3] += basis[k + i / 3] * sh[i];
  }
  return {greatest(color[0], 0.f), greatest(color[1], 0.f), greatest(color[2], 0.f)};
}

SPLATREE_FN Vector color_of(const FrameJob* job, const Point& p, long long row) {
  switch (job->numbers.degree) {
    case 0:
      return color_of<0>(job, p, row);
    case 1:
      return color_of<1>(job, p, row);
    case 2:
      return color_of<2>(job, p, row);
    default:
      return color_of<3>(job, p, row);
  }
}

template <bool ANTIALIASED, bool SQUARE>
SPLATREE_FN Splat shape_of(const FrameNumbers& n, const Image& image, float z, const Factor& m, float sigmoid) {
  View view = n.view;
  view.log2_threshold = n.log2_pixel_threshold;  // the box holds every pixel that is drawn, the tiles those above τ
  return splat_of<ANTIALIASED, SQUARE>(view, n.square, image.x, image.y, z, m.x, m.y, sigmoid);
}

}  // namespace
}  // namespace splatree

using namespace splatree;

SPLATREE_KERNEL(128, 6) project(const FrameJob* job) {
  const long long i = index_of_thread();
  const bool asked = i < held(job->counters[NUM_SELECTED], job->row_capacity);
  bool visible = false;
  if (asked) {
    const FrameNumbers& n = job->numbers;
    const long long row = job->rows[i];
    const Point p = load_point(job, row);
    const Image image = image_of(n.view, p.x, p.y, p.z);
    const float4 quat = job->quats[row];
    Vector scale = scale_of(n.view, p.z, load_vector(job->log_scales, row));
    float sigmoid = sigmoid_of(job->logit_opacities[row]);
    if (job->follows && !n.view.antialiased) {
      const float4 c = job->curves[row];
      const float dilation = n.view.dilation / (n.view.fx * n.view.fy) * p.z * p.z;
      const Followed f = followed_of({c.x, c.y, c.z, c.w}, dilation, scale, sigmoid);
      scale = f.scale, sigmoid = f.opacity;
    }
    const Factor m = factor_of(image.tx, image.ty, quat.x, quat.y, quat.z, quat.w, scale);
    const bool is_square = n.tile_rule == int(TileRule::SQUARE);
    const Splat s = n.view.antialiased ? is_square ? shape_of<true, true>(n, image, p.z, m, sigmoid)
                                                   : shape_of<true, false>(n, image, p.z, m, sigmoid)
                    : is_square ? shape_of<false, true>(n, image, p.z, m, sigmoid)
                                       : shape_of<false, false>(n, image, p.z, m, sigmoid);
    visible = s.visible;
    // Depths of what is visible are positive: their bits order as they do.
    job->depth_keys[i] = visible ? (unsigned)bits_of(p.z) : NOT_VISIBLE;
    if (visible) {
      const Vector color = color_of(job, p, row);
      job->records[4 * i] = make_float4(image.x, image.y, s.a, s.b);
      job->records[4 * i + 1] = make_float4(s.c, s.opacity, s.log2_opacity, color.x);
      job->records[4 * i + 2] = make_float4(color.y, color.z, p.z, s.half_size_x);
      job->records[4 * i + 3] = make_float4(s.half_size_y, 0.f, 0.f, 0.f);
    }
  }
  count_lanes(job, NUM_VISIBLE, visible);
}
