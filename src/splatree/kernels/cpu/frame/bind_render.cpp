// Glue of the frame's stages: project, order, bin, blend. Sizes are checked by the callers in kernels/cpu/*.py.
#include <nanobind/stl/array.h>
#include <nanobind/stl/optional.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <optional>
#include <string>

#include "cpu/frame/blend.h"
#include "cpu/frame/project.h"
#include "cpu/frame/scatter.h"
#include "cpu/frame/view.h"
#include "cpu/runtime/in_order.h"
#include "cpu/runtime/isa.h"
#include "shared/constants.h"

namespace splatree {
namespace {

// `out` are arrays to fill: rows, records and depths of the splats.
int64_t project_rows(py::Gaussians gaussians, std::optional<In<float>> curves, In<int32_t> rows, py::PackedView packed,
                     py::View view, std::optional<py::SquareRule> square, nb::dict out, int threads) {
  const int64_t num_rows = int64_t(rows.shape(0));
  View seen = view_of(packed, number<double>(view, "pixel_threshold"), number<std::string>(view, "mode") == "antialiased");
  seen.least_opacity = number_of(view, "least_opacity");
  const ProjectJob job{column<float>(gaussians, "means"),
                       column<float>(gaussians, "quats"),
                       column<float>(gaussians, "log_scales"),
                       column<float>(gaussians, "logit_opacities"),
                       column<float>(gaussians, "sh"),
                       curves ? curves->data() : nullptr,
                       int(number<In<float>>(gaussians, "sh").shape(1)),
                       std::min(number<int>(view, "sh_degree"), number<int>(gaussians, "sh_degree")),
                       seen,
                       square.has_value(),
                       square ? square_of(*square) : Square{},
                       rows.data(),
                       num_rows,
                       threads,
                       out_entry<int32_t>(out, "rows"),
                       out_entry<float>(out, "records"),
                       out_entry<float>(out, "depths")};
  nb::gil_scoped_release release;
  InOrder results((num_rows + PROJECT_CHUNK - 1) / PROJECT_CHUNK, kernels().project_buffer_bytes());
  kernels().project(job, results);
  return results.total();
}

void order_splats(In<float> depths, In<int32_t> rows, std::optional<In<uint32_t>> ids, Out<int32_t> order, int threads) {
  const uint32_t* id = ids ? ids->data() : nullptr;
  nb::gil_scoped_release release;
  order_by_depth(depths.data(), rows.data(), id, int64_t(order.shape(0)), threads, order.data());
}

nb::ndarray<nb::numpy, int32_t, nb::ndim<1>> bin_splats(py::Splats splats, py::View view, std::optional<py::SquareRule> square,
                                                        bool whole_box, Out<int64_t> tile_start, std::optional<Out<float>> floors,
                                                        int threads) {
  const nb::object camera = view.attr("camera");
  const int width = number<int>(camera, "width"), height = number<int>(camera, "height");
  const auto order = number<In<int32_t>>(splats, "order");
  const BinJob job{column<float>(splats, "records"),
                   order.data(),
                   int64_t(order.shape(0)),
                   float(std::log2(number<double>(view, "threshold"))),
                   number_of(view, "area_power"),
                   width,
                   height,
                   (width + constants::TILE_PX - 1) / constants::TILE_PX,
                   (height + constants::TILE_PX - 1) / constants::TILE_PX,
                   square      ? TileRule::SQUARE
                   : whole_box ? TileRule::BOX
                               : TileRule::ELLIPSE,
                   square ? square_of(*square) : Square{},
                   threads,
                   floors ? floors->data() : nullptr};
  Scratch<int32_t> pairs;
  {
    nb::gil_scoped_release release;
    pairs = bin(job, tile_start.data());
  }
  const nb::capsule owner(pairs.get(), [](void* p) noexcept { Free()(p); });
  const size_t num_pairs = size_t(tile_start.data()[job.num_tiles_x * job.num_tiles_y]);
  return nb::ndarray<nb::numpy, int32_t, nb::ndim<1>>(pairs.release(), {num_pairs}, owner);
}

// `outputs` are arrays to fill by the names of Picture and TileWork; those that are not there are not wanted.
void blend_tiles(py::Splats splats, py::TileBins bins, py::View view, bool whole_tile, nb::dict outputs, int threads) {
  const nb::object camera = view.attr("camera");
  const auto background = number<std::array<double, 3>>(view, "background");
  const BlendJob job{column<float>(splats, "records"),
                     column<int64_t>(bins, "tile_start"),
                     column<int32_t>(bins, "splat_from_pair"),
                     number<int>(bins, "num_tiles_x"),
                     number<int>(bins, "num_tiles_y"),
                     number<int>(camera, "width"),
                     number<int>(camera, "height"),
                     float(std::log2(number<double>(view, "pixel_threshold"))),
                     optional_column<float>(bins, "floors"),
                     {float(background[0]), float(background[1]), float(background[2])},
                     number_of(view, "least_light"),
                     whole_tile,
                     threads,
                     out_entry<float>(outputs, "image"),
                     out_entry<float>(outputs, "alpha"),
                     out_entry<float>(outputs, "depth"),
                     out_entry<float>(outputs, "contributions"),
                     out_entry<int64_t>(outputs, "last_pair"),
                     out_entry<float>(outputs, "median_depth"),
                     out_entry<int64_t>(outputs, "consumed"),
                     out_entry<int64_t>(outputs, "evaluated"),
                     out_entry<int64_t>(outputs, "blended")};
  nb::gil_scoped_release release;
  kernels().blend(job);
}

}  // namespace

void bind_render(nb::module_& m) {
  m.def("project_rows", &project_rows, nb::arg("gaussians"), nb::arg("curves").none(), nb::arg("rows"), nb::arg("packed"),
        nb::arg("view"), nb::arg("square").none(), nb::arg("out"), nb::arg("threads"),
        "Project rows; returns the number of records written.");
  m.def("order_splats", &order_splats, nb::arg("depths"), nb::arg("rows"), nb::arg("ids").none(), nb::arg("order"),
        nb::arg("threads"), "Indices of the splats by depth, equal depths by id.");
  m.def("bin_splats", &bin_splats, nb::arg("splats"), nb::arg("view"), nb::arg("square").none(), nb::arg("whole_box"),
        nb::arg("tile_start"), nb::arg("floors").none(), nb::arg("threads"),
        "Fill tile_start and return the splats of all tiles.");
  m.def("blend_tiles", &blend_tiles, nb::arg("splats"), nb::arg("bins"), nb::arg("view"), nb::arg("whole_tile"),
        nb::arg("outputs"), nb::arg("threads"), "Blend all tiles and count the work of each.");
}

}  // namespace splatree
