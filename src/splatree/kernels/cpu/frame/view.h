// How glue hands a camera and the options of the selection to the kernels.
#pragma once
#include <cmath>

#include "cpu/runtime/scene.h"
#include "shared/select.h"

namespace splatree {

// The number `name` of a struct, as a float.
inline float number_of(nb::handle owner, const char* name) { return float(number<double>(owner, name)); }

// The rule of the squares from SquareRule of Python.
inline Square square_of(const py::SquareRule& rule) {
  return {float(std::log2(nb::cast<double>(rule.attr("threshold")))), number_of(rule, "energy_min"), number_of(rule, "ratio_min"),
          number_of(rule, "pad_px"), number_of(rule, "eigenvalue_floor_px4")};
}

// The view from PackedView of kernels/cpu/frame/view.py.
inline View view_of(const nb::object& packed, double threshold, bool antialiased) {
  View view{};
  const double* rotation = column<double>(packed, "rotation");
  for (int i = 0; i < 9; ++i) view.rotation[i] = float(rotation[i]);
  const double* center = column<double>(packed, "center");
  for (int i = 0; i < 3; ++i) {
    float high = float(center[i]);
    // GCC 12 makes vectors of these statements and takes a double rounded to float and back for the double itself: low would be
    // 0.
    asm("" : "+m"(high));
    view.center_high[i] = high;
    view.center_low[i] = float(center[i] - double(high));
  }
  view.fx = number_of(packed, "fx"), view.fy = number_of(packed, "fy");
  view.cx = number_of(packed, "cx"), view.cy = number_of(packed, "cy");
  view.width = number_of(packed, "width"), view.height = number_of(packed, "height");
  view.near = number_of(packed, "near");
  view.slope_min_x = number_of(packed, "slope_min_x"), view.slope_max_x = number_of(packed, "slope_max_x");
  view.slope_min_y = number_of(packed, "slope_min_y"), view.slope_max_y = number_of(packed, "slope_max_y");
  view.dilation = number_of(packed, "dilation");
  view.sigma_max = number_of(packed, "sigma_max");
  view.least_opacity = float(threshold);
  view.log2_threshold = float(std::log2(threshold));
  view.antialiased = antialiased;
  return view;
}

constexpr Choice<ViewTest> VIEW_TESTS[] = {{"footprint", FOOTPRINT}, {"centre", CENTRE}, {"none", UNSEEN_TOO}};

// The rule from PackedRule of kernels/cpu/frame/question.py.
inline SelectRule rule_of(nb::handle packed) {
  SelectRule rule{};
  rule.limit = number_of(packed, "limit");
  rule.add = number_of(packed, "add");
  rule.least_diagonal = number_of(packed, "least_diagonal");
  rule.floor = number_of(packed, "floor");
  rule.pixel_error = number_of(packed, "pixel_error");
  rule.focal_max = number_of(packed, "focal_max"), rule.focal_min = number_of(packed, "focal_min");
  rule.k_max = number_of(packed, "k_max");
  rule.logit_min = number_of(packed, "logit_min");
  rule.pad_x = number_of(packed, "pad_x"), rule.pad_y = number_of(packed, "pad_y");
  rule.sphere = nb::cast<bool>(packed.attr("sphere"));
  rule.ball = number_of(packed, "ball");
  return rule;
}

// The planes from rows (x, y, z, d).
inline ViewPlanes planes_of(const double* rows, int count) {
  ViewPlanes planes{};
  for (int i = 0; i < count; ++i, rows += 4)
    planes.x[i] = rows[0], planes.y[i] = rows[1], planes.z[i] = rows[2], planes.d[i] = rows[3];
  return planes;
}

// What is asked of each row, from PackedQuestion of kernels/cpu/frame/question.py, to a job of the processor or of a GPU.
template <class Job>
void ask(const py::PackedQuestion& question, Job& job) {
  const nb::object view = question.attr("view");
  job.view = view_of(view, number<double>(question, "threshold"), false);
  job.rule = rule_of(question.attr("rule"));
  job.view_test = chosen(number<std::string>(question, "view_test"), "view_test", VIEW_TESTS);
  job.all_small = std::isinf(job.rule.pixel_error);
  const double* center = column<double>(view, "center");
  for (int i = 0; i < 3; ++i) job.eye[i] = center[i];
}

// What is asked of each block, from PackedSides.
template <class Job>
void bound(const py::PackedSides& sides, Job& job) {
  job.cull = number<bool>(sides, "is_culled");
  const auto planes = number<In<double>>(sides, "planes");
  job.planes = planes_of(planes.data(), int(planes.shape(0)));
  const double* reaches = column<double>(sides, "reaches");
  for (int i = 0; i < NUM_SIDES; ++i) job.reach[i] = reaches[i];
}

}  // namespace splatree
