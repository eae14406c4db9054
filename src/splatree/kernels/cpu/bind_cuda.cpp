// The numbers of a frame as kernels on a GPU take them: laid out here, where the compiler knows the structs.
#include <nanobind/stl/optional.h>

#include <cmath>
#include <optional>

#include "cpu/arrays.h"
#include "cpu/view.h"
#include "cuda/job.h"

namespace splatree {
namespace {

nb::bytes frame_numbers(In<double> view, double threshold, double area_power, double least_threshold, double least_opacity, double pixel_threshold, bool antialiased,
                        In<double> rule, int visibility, bool cull, In<double> planes, In<double> reach, int degree,
                        int width, int height, In<double> background, std::optional<In<double>> square, bool whole_box) {
  FrameNumbers n{};
  n.view = view_of(view.data(), least_threshold, antialiased);
  n.view.least_opacity = float(least_opacity);
  n.rule = rule_of(rule.data());
  n.planes = planes_of(planes.data(), int(planes.shape(0)));
  for (int i = 0; i < NUM_SIDES; ++i) n.reach[i] = reach.data()[i];
  for (int i = 0; i < 3; ++i) n.eye[i] = view.data()[9 + i];
  n.visibility = visibility;
  n.all_small = std::isinf(n.rule.pixel_error);
  n.cull = cull;
  n.degree = degree;
  n.width = width, n.height = height;
  n.num_tiles_x = (width + 15) / 16, n.num_tiles_y = (height + 15) / 16;
  for (int i = 0; i < 3; ++i) n.background[i] = float(background.data()[i]);
  n.log2_threshold = float(std::log2(threshold)), n.area_power = float(area_power);
  n.log2_pixel_threshold = float(std::log2(pixel_threshold));
  n.extent = int(square ? Extent::SQUARE : whole_box ? Extent::BOX : Extent::ELLIPSE);
  if (square) n.square = square_of(square->data());
  return nb::bytes(reinterpret_cast<const char*>(&n), sizeof n);
}

}  // namespace

void bind_cuda(nb::module_& m) {
  m.def("frame_numbers", &frame_numbers, nb::arg("view"), nb::arg("threshold"), nb::arg("area_power"), nb::arg("least_threshold"), nb::arg("least_opacity"),
        nb::arg("pixel_threshold"), nb::arg("antialiased"), nb::arg("rule"), nb::arg("visibility"), nb::arg("cull"),
        nb::arg("planes"), nb::arg("reach"), nb::arg("degree"), nb::arg("width"), nb::arg("height"), nb::arg("background"),
        nb::arg("square").none(), nb::arg("whole_box"), "The struct FrameNumbers of kernels/cuda/job.h as bytes.");
}

}  // namespace splatree
