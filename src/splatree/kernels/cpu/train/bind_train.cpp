// Glue of the stages that training needs: backward over pixels and splats, the loss, the optimiser's step. Sizes are checked by
// the callers in kernels/cpu.
#include <nanobind/stl/array.h>
#include <nanobind/stl/optional.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <optional>
#include <string>
#include <vector>

#include "cpu/frame/blend_backward.h"
#include "cpu/frame/project_backward.h"
#include "cpu/frame/view.h"
#include "cpu/runtime/isa.h"
#include "cpu/runtime/scratch.h"
#include "cpu/train/train.h"

namespace splatree {
namespace {

// `out` are arrays to fill by the names of SplatGradients.
void blend_backward_tiles(py::Splats splats, py::TileBins bins, py::View view, py::Picture picture, py::PictureGradients upstream,
                          nb::dict out, int threads) {
  const nb::object camera = view.attr("camera");
  const auto background = number<std::array<double, 3>>(view, "background");
  const auto splat_from_pair = number<In<int32_t>>(bins, "splat_from_pair");
  const BlendBackwardJob job{column<float>(splats, "records"),
                             column<int64_t>(bins, "tile_start"),
                             splat_from_pair.data(),
                             int64_t(number<In<int32_t>>(splats, "rows").shape(0)),
                             number<int>(bins, "num_tiles_x"),
                             number<int>(bins, "num_tiles_y"),
                             number<int>(camera, "width"),
                             number<int>(camera, "height"),
                             float(std::log2(number<double>(view, "pixel_threshold"))),
                             {float(background[0]), float(background[1]), float(background[2])},
                             column<float>(picture, "image"),
                             column<float>(picture, "alpha"),
                             column<float>(picture, "depth"),
                             column<float>(upstream, "image"),
                             optional_column<float>(upstream, "alpha"),
                             optional_column<float>(upstream, "depth"),
                             optional_column<float>(upstream, "errors"),
                             threads,
                             out_entry<float>(out, "moments"),
                             out_entry<float>(out, "colors"),
                             out_entry<float>(out, "depths"),
                             out_entry<float>(out, "weights"),
                             out_entry<float>(out, "errors")};
  const int64_t num_pairs = int64_t(splat_from_pair.shape(0));
  nb::gil_scoped_release release;
  const Scratch<float> sums = allocate<float>(num_pairs * NUM_SUMS);
  const Scratch<uint8_t> touched = allocate<uint8_t>(num_pairs);
  const PairSums pairs{sums.get(), touched.get()};
  kernels().blend_backward(job, pairs);
  sum_pairs(job, pairs);
}

// `out` are arrays to fill by the names of GaussianGradients.
void project_backward_rows(py::Gaussians gaussians, py::Splats splats, py::SplatGradients gradients, py::PackedView packed,
                           py::View view, nb::dict out, int threads) {
  const auto rows = number<In<int32_t>>(splats, "rows");
  const ProjectBackwardJob job{
      column<float>(gaussians, "means"),
      column<float>(gaussians, "quats"),
      column<float>(gaussians, "log_scales"),
      column<float>(gaussians, "logit_opacities"),
      column<float>(gaussians, "sh"),
      int(number<In<float>>(gaussians, "sh").shape(1)),
      std::min(number<int>(view, "sh_degree"), number<int>(gaussians, "sh_degree")),
      view_of(packed, number<double>(view, "pixel_threshold"), number<std::string>(view, "mode") == "antialiased"),
      rows.data(),
      column<float>(splats, "records"),
      int64_t(rows.shape(0)),
      column<float>(gradients, "moments"),
      column<float>(gradients, "colors"),
      optional_column<float>(gradients, "depths"),
      threads,
      out_entry<float>(out, "means"),
      out_entry<float>(out, "quats"),
      out_entry<float>(out, "log_scales"),
      out_entry<float>(out, "logit_opacities"),
      out_entry<float>(out, "sh")};
  nb::gil_scoped_release release;
  kernels().project_backward(job);
}

// The sums of the whole picture: |difference|, index, products, squares (LossSum). `weights` are those of difference and index.
std::array<double, NUM_LOSS_SUMS> compare_photo(In<float> image, In<uint8_t> photo, std::optional<In<uint8_t>> mask,
                                                std::array<double, 3> gain, std::array<double, LOSS_TAPS> taps,
                                                std::array<double, 2> constants, std::array<double, 2> weights,
                                                Out<float> by_image, Out<float> errors, int threads) {
  const int height = int(image.shape(0)), width = int(image.shape(1));
  const int64_t areas = ((width + LOSS_EDGE_X - 1) / LOSS_EDGE_X) * ((height + LOSS_EDGE_Y - 1) / LOSS_EDGE_Y);
  std::vector<double> sums(areas * NUM_LOSS_SUMS);
  LossJob job{};
  job.image = image.data(), job.photo = photo.data(), job.mask = mask ? mask->data() : nullptr;
  for (int c = 0; c < 3; ++c) job.gain[c] = float(gain[c]);
  for (int t = 0; t < LOSS_TAPS; ++t) job.taps[t] = float(taps[t]);
  job.c1 = float(constants[0]), job.c2 = float(constants[1]);
  job.width = width, job.height = height;
  job.by_difference = float(weights[0]), job.by_index = float(weights[1]);
  job.threads = threads;
  job.by_image = by_image.data(), job.errors = errors.data(), job.sums = sums.data();
  std::array<double, NUM_LOSS_SUMS> total{};
  nb::gil_scoped_release release;
  kernels().photo_loss(job);
  for (int64_t area = 0; area < areas; ++area)
    for (int k = 0; k < NUM_LOSS_SUMS; ++k) total[k] += sums[area * NUM_LOSS_SUMS + k];
  return total;
}

constexpr const char* COLUMNS[] = {"means", "quats", "log_scales", "logit_opacities", "sh"};

// `settings`: 1 / steps until the full rate, β₁, β₂, ε.
void step_rows(py::Gaussians gaussians, py::GaussianGradients gradients, Out<float> moments, Out<uint16_t> steps, In<float> rates,
               In<float> corrections, std::array<double, 4> settings, int threads) {
  const auto rows = number<In<int32_t>>(gradients, "rows");
  StepJob job{};
  job.num_rows = int64_t(rows.shape(0)), job.rows = rows.data();
  job.num_columns = 5;
  for (int c = 0; c < 5; ++c) {
    const auto column_of = number<Out<float>>(gaussians, COLUMNS[c]);
    job.columns[c] = column_of.data();
    job.derivatives[c] = column<float>(gradients, COLUMNS[c]);
    job.widths[c] = 1;
    for (size_t axis = 1; axis < column_of.ndim(); ++axis) job.widths[c] *= int(column_of.shape(axis));
  }
  job.moments = moments.data(), job.steps = steps.data(), job.num_moments = int(moments.shape(2));
  job.rates = rates.data(), job.corrections = corrections.data();
  job.ramp = float(settings[0]), job.beta_1 = float(settings[1]), job.beta_2 = float(settings[2]),
  job.epsilon = float(settings[3]);
  job.threads = threads;
  nb::gil_scoped_release release;
  kernels().step_rows(job);
}

}  // namespace

void bind_train(nb::module_& m) {
  m.def("blend_backward_tiles", &blend_backward_tiles, nb::arg("splats"), nb::arg("bins"), nb::arg("view"), nb::arg("picture"),
        nb::arg("upstream"), nb::arg("out"), nb::arg("threads"), "Sums over the pixels of each splat.");
  m.def("project_backward_rows", &project_backward_rows, nb::arg("gaussians"), nb::arg("splats"), nb::arg("gradients"),
        nb::arg("packed"), nb::arg("view"), nb::arg("out"), nb::arg("threads"), "Derivatives by the columns of Gaussians.");
  m.def("compare_photo", &compare_photo, nb::arg("image"), nb::arg("photo"), nb::arg("mask").none(), nb::arg("gain"),
        nb::arg("taps"), nb::arg("constants"), nb::arg("weights"), nb::arg("by_image"), nb::arg("errors"), nb::arg("threads"),
        "Compare a picture with a photograph; returns sums over the pixels.");
  m.def("step_rows", &step_rows, nb::arg("gaussians"), nb::arg("gradients"), nb::arg("moments"), nb::arg("steps"),
        nb::arg("rates"), nb::arg("corrections"), nb::arg("settings"), nb::arg("threads"), "A step of the optimiser, in place.");
}

}  // namespace splatree
