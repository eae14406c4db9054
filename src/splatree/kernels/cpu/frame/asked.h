// What the selection asks of rows: how large, and whether it can be seen, 16 gathered rows at a time. So a row's answer does not
// depend on its place. For select.cpp alone, which is compiled for each instruction set.
#pragma once
#include "cpu/frame/select.h"
#include "cpu/runtime/isa.h"

namespace splatree::SPLATREE_ISA {
namespace {

constexpr int LANES = 16;

struct alignas(64) Planes {
  float mean[3][LANES], log_scale[3][LANES], quat[4][LANES], logit[LANES], extent[LANES];
  float size[LANES];
  int32_t answer[LANES];
};

template <int WIDTH>
void gather(const float* column, const int32_t* rows, float (*planes)[LANES]) {
  for (int l = 0; l < LANES; ++l) {
    const float* row = column + int64_t(rows[l]) * WIDTH;
    for (int i = 0; i < WIDTH; ++i) planes[i][l] = row[i];
  }
}

// A list of rows with room to fill its last vector by repetition.
struct Rows {
  int32_t row[MAX_BLOCK_ROWS + LANES];
  int size = 0;

  void pad() {
    for (int l = 0; l < LANES; ++l) row[size + l] = size ? row[size - 1] : 0;
  }
};

// The sizes of 16 rows.
void measure(const SelectJob& job, const int32_t* rows, Planes& p) {
  gather<3>(job.means, rows, p.mean);
  if (job.rule.sphere) {
    gather<1>(job.extents, rows, &p.extent);
#pragma omp simd
    for (int l = 0; l < LANES; ++l)
      p.size[l] = size_of_extent(job.rule, point_of(job.view, p.mean[0][l], p.mean[1][l], p.mean[2][l]), p.extent[l]);
    return;
  }
  gather<3>(job.log_scales, rows, p.log_scale);
  gather<4>(job.quats, rows, p.quat);
#pragma omp simd
  for (int l = 0; l < LANES; ++l) {
    const Point point = point_of(job.view, p.mean[0][l], p.mean[1][l], p.mean[2][l]);
    const Factor m = factor_of(job.view, point, p.quat[0][l], p.quat[1][l], p.quat[2][l], p.quat[3][l],
                               {p.log_scale[0][l], p.log_scale[1][l], p.log_scale[2][l]});
    p.size[l] = size_of(job.view, job.rule, point, m);
  }
}

void answer_small(const SelectJob& job, const int32_t* rows, Planes& p) {
  measure(job, rows, p);
  for (int l = 0; l < LANES; ++l) p.answer[l] = p.size[l] <= job.rule.limit;
}

void answer_visible_bounds(const SelectJob& job, const int32_t* rows, Planes& p) {
  gather<3>(job.means, rows, p.mean);
  if (job.view_test == CENTRE) {
#pragma omp simd
    for (int l = 0; l < LANES; ++l)
      p.answer[l] = is_centred(job.view, job.rule, point_of(job.view, p.mean[0][l], p.mean[1][l], p.mean[2][l]));
    return;
  }
  gather<3>(job.log_scales, rows, p.log_scale);
  gather<1>(job.logit_opacities, rows, &p.logit);
#pragma omp simd
  for (int l = 0; l < LANES; ++l)
    p.answer[l] = is_visible_bound(job.view, job.rule, point_of(job.view, p.mean[0][l], p.mean[1][l], p.mean[2][l]),
                                   {p.log_scale[0][l], p.log_scale[1][l], p.log_scale[2][l]}, p.logit[l]);
}

void answer_visible(const SelectJob& job, const int32_t* rows, Planes& p) {
  gather<3>(job.means, rows, p.mean);
  gather<3>(job.log_scales, rows, p.log_scale);
  gather<4>(job.quats, rows, p.quat);
  gather<1>(job.logit_opacities, rows, &p.logit);
#pragma omp simd
  for (int l = 0; l < LANES; ++l) {
    const Point point = point_of(job.view, p.mean[0][l], p.mean[1][l], p.mean[2][l]);
    const Factor m = factor_of(job.view, point, p.quat[0][l], p.quat[1][l], p.quat[2][l], p.quat[3][l],
                               {p.log_scale[0][l], p.log_scale[1][l], p.log_scale[2][l]});
    p.answer[l] = is_visible(job.view, point, m, p.logit[l]);
  }
}

using Answers = void (*)(const SelectJob&, const int32_t*, Planes&);

// The answers to `ask` for a padded list.
void ask_all(const SelectJob& job, Answers ask, const Rows& rows, uint8_t* answers) {
  Planes planes;
  for (int begin = 0; begin < rows.size; begin += LANES) {
    ask(job, rows.row + begin, planes);
    for (int l = 0; l < LANES; ++l) answers[begin + l] = uint8_t(planes.answer[l]);
  }
}

// Whether each row of a padded list can be seen: 0 or 1.
void ask_visible(const SelectJob& job, const Rows& rows, uint8_t* answers) {
  ask_all(job, answer_visible_bounds, rows, answers);
  Rows open;
  int32_t place[MAX_BLOCK_ROWS + LANES];
  int size = 0;
  for (int i = 0; i < rows.size; ++i) {
    open.row[size] = rows.row[i];
    place[size] = i;
    size += answers[i] == OPEN;
  }
  if (!size) return;
  open.size = size;
  open.pad();
  uint8_t full[MAX_BLOCK_ROWS + LANES];
  ask_all(job, answer_visible, open, full);
  for (int i = 0; i < size; ++i) answers[place[i]] = full[i];
}

}  // namespace
}  // namespace splatree::SPLATREE_ISA
