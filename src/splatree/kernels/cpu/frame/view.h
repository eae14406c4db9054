// How glue hands a camera and the options of the selection to the kernels.
#pragma once
#include <cmath>

#include "shared/select.h"

namespace splatree {

// The rule of the squares from the doubles that kernels/cpu/frame/view.py packs.
inline Square square_of(const double* v) { return {float(std::log2(v[0])), float(v[1]), float(v[2]), float(v[3]), float(v[4])}; }

// The view from the doubles that kernels/cpu/frame/view.py packs, in their order.
inline View view_of(const double* v, double threshold, bool antialiased) {
  View view{};
  for (int i = 0; i < 9; ++i) view.rotation[i] = float(*v++);
  for (int i = 0; i < 3; ++i) {
    view.center_high[i] = float(*v);
    view.center_low[i] = float(*v - view.center_high[i]);
    ++v;
  }
  float* const rest[] = {&view.fx,          &view.fy,       &view.cx,          &view.cy,          &view.width,
                         &view.height,      &view.near,     &view.slope_min_x, &view.slope_max_x, &view.slope_min_y,
                         &view.slope_max_y, &view.dilation, &view.sigma_max};
  for (float* field : rest) *field = float(*v++);
  view.least_opacity = float(threshold);
  view.log2_threshold = float(std::log2(threshold));
  view.antialiased = antialiased;
  return view;
}

// The rule from the doubles that kernels/cpu/frame/select.py packs.
inline SelectRule rule_of(const double* v) {
  SelectRule rule{};
  float* const fields[] = {&rule.limit,     &rule.add,   &rule.least_diagonal, &rule.floor, &rule.pixel_error, &rule.focal_max,
                           &rule.focal_min, &rule.k_max, &rule.logit_min,      &rule.pad_x, &rule.pad_y};
  for (float* field : fields) *field = float(*v++);
  rule.sphere = *v++ != 0;
  return rule;
}

// The planes from rows (x, y, z, d).
inline ViewPlanes planes_of(const double* rows, int count) {
  ViewPlanes planes{};
  for (int i = 0; i < count; ++i, rows += 4)
    planes.x[i] = rows[0], planes.y[i] = rows[1], planes.z[i] = rows[2], planes.d[i] = rows[3];
  return planes;
}

}  // namespace splatree
