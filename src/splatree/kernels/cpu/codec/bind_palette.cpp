// Glue of vector quantisation: arrays are made and checked in palette.py.
#include "cpu/codec/intervals.h"
#include "cpu/codec/palette.h"
#include "cpu/codec/scores.h"
#include "cpu/runtime/arrays.h"
#include "cpu/runtime/isa.h"
#include "cpu/runtime/pool.h"

using namespace nanobind::literals;

namespace splatree {
namespace {

Points points_of(const In<float>& points) {
  return {points.data(), static_cast<int64_t>(points.shape(0)), static_cast<int64_t>(points.shape(1))};
}

// `vectors` are rows of the harmonics, whose first `skipped` values are left out.
void bind_onto_axes(const In<float>& vectors, int64_t skipped, const In<float>& origin, const In<float>& axes,
                    const Out<float>& out, int threads) {
  const int64_t stride = vectors.shape(1);
  const AxesJob job{vectors.data() + skipped, stride,    stride - skipped, origin.data(), axes.data(),
                    int64_t(out.shape(1)),    out.data()};
  nb::gil_scoped_release released;
  parallel_ranges(static_cast<int64_t>(out.shape(0)), 4096, threads,
                  [&](int64_t begin, int64_t end) { kernels().onto_axes(job, begin, end); });
}

void bind_nearest_few(const In<float>& points, const In<float>& centres, const Out<int32_t>& near, int threads) {
  nb::gil_scoped_release released;
  nearest_few(points_of(points), centres.data(), centres.shape(0), near.shape(1), near.data(), threads);
}

void bind_split_groups(const In<float>& points, const In<float>& weights, const In<int64_t>& start, const In<int32_t>& rows,
                       const In<int64_t>& first_centre, int iterations, const Out<float>& centres, int threads) {
  nb::gil_scoped_release released;
  split_groups(points_of(points), weights.data(), start.data(), rows.data(), first_centre.data(),
               static_cast<int64_t>(start.shape(0)) - 1, iterations, centres.data(), threads);
}

void bind_nearest_in_groups(const In<float>& points, const In<float>& centres, const In<int64_t>& first_centre,
                            const In<int32_t>& near, const Out<int32_t>& label, int threads) {
  nb::gil_scoped_release released;
  nearest_in_groups(points_of(points), centres.data(), first_centre.data(), static_cast<int64_t>(first_centre.shape(0)) - 1,
                    near.data(), near.shape(1), label.data(), threads);
}

void bind_label_means(const In<float>& vectors, int64_t skipped, const In<float>& weights, const In<int64_t>& start,
                      const In<int32_t>& rows, const Out<float>& means, int threads) {
  const int64_t stride = vectors.shape(1);
  nb::gil_scoped_release released;
  label_means(vectors.data() + skipped, stride, stride - skipped, weights.data(), start.data(), rows.data(),
              static_cast<int64_t>(means.shape(0)), means.data(), threads);
}

void bind_add_to_sums(const In<float>& vectors, int64_t skipped, const In<float>& weights, const In<int32_t>& labels,
                      const Out<double>& sums) {
  const int64_t stride = vectors.shape(1);
  nb::gil_scoped_release released;
  add_to_sums(vectors.data() + skipped, stride, stride - skipped, weights.data(), labels.data(),
              static_cast<int64_t>(vectors.shape(0)), sums.data());
}

int64_t bind_distinct_rows(const In<float>& vectors, int64_t skipped, const Out<float>& entries,
                           const Out<int32_t>& label_from_slot, int64_t count, const Out<int32_t>& label) {
  const int64_t stride = vectors.shape(1);
  const DistinctRows known{static_cast<int64_t>(entries.shape(0)), entries.data(), static_cast<int64_t>(label_from_slot.shape(0)),
                           label_from_slot.data()};
  nb::gil_scoped_release released;
  return distinct_rows(vectors.data() + skipped, stride, stride - skipped, static_cast<int64_t>(vectors.shape(0)), known, count,
                       label.data());
}

void bind_best_intervals(const In<double>& mass, const In<double>& moment, const In<double>& square, const Out<int64_t>& cuts) {
  nb::gil_scoped_release released;
  best_intervals(mass.data(), moment.data(), square.data(), static_cast<int64_t>(mass.shape(0)) - 1,
                 static_cast<int64_t>(cuts.shape(0)) - 1, cuts.data());
}

}  // namespace

void bind_palette(nb::module_& m) {
  m.def("onto_axes", &bind_onto_axes, "vectors"_a, "skipped"_a, "origin"_a, "axes"_a, "out"_a, "threads"_a = 0);
  m.def("nearest_few", &bind_nearest_few, "points"_a, "centres"_a, "near"_a, "threads"_a = 0);
  m.def("split_groups", &bind_split_groups, "points"_a, "weights"_a, "start"_a, "rows"_a, "first_centre"_a, "iterations"_a,
        "centres"_a, "threads"_a = 0);
  m.def("nearest_in_groups", &bind_nearest_in_groups, "points"_a, "centres"_a, "first_centre"_a, "near"_a, "label"_a,
        "threads"_a = 0);
  m.def("label_means", &bind_label_means, "vectors"_a, "skipped"_a, "weights"_a, "start"_a, "rows"_a, "means"_a, "threads"_a = 0);
  m.def("best_intervals", &bind_best_intervals, "mass"_a, "moment"_a, "square"_a, "cuts"_a);
  m.def("add_to_sums", &bind_add_to_sums, "vectors"_a, "skipped"_a, "weights"_a, "labels"_a, "sums"_a);
  m.def("distinct_rows", &bind_distinct_rows, "vectors"_a, "skipped"_a, "entries"_a, "label_from_slot"_a, "count"_a, "label"_a);
}

}  // namespace splatree
