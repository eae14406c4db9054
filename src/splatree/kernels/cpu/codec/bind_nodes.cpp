#include <nanobind/stl/optional.h>

#include <cmath>
#include <optional>

#include "cpu/codec/nodes.h"
#include "cpu/codec/slots.h"
#include "cpu/runtime/structs.h"

namespace splatree {

using namespace nb::literals;

namespace {

NodeColumns columns_of(nb::handle gaussians) {
  const size_t k = nb::cast<In<float>>(gaussians.attr("sh")).shape(1);
  return {column<float>(gaussians, "means"),      column<float>(gaussians, "quats"),
          column<float>(gaussians, "log_scales"), column<float>(gaussians, "logit_opacities"),
          column<float>(gaussians, "sh"),         static_cast<int>(std::lround(std::sqrt(k))) - 1};
}

void bind_pack_nodes(nb::handle gaussians, nb::handle tree, const std::optional<In<float>>& curves, const In<int32_t>& rows,
                     const std::optional<In<float>>& dilations, const In<double>& eye, const In<double>& centre,
                     const Out<uint32_t>& out, int threads) {
  const NodeColumns columns = columns_of(gaussians);
  const NodeTree of_tree = {column<int32_t>(tree, "subtree_end"), column<uint8_t>(tree, "depth"),
                            curves ? curves->data() : nullptr};
  const float* at = dilations ? dilations->data() : nullptr;
  nb::gil_scoped_release released;
  pack_nodes(columns, of_tree, rows.data(), at, static_cast<int64_t>(rows.size()), eye.data(), centre.data(), out.data(),
             threads);
}

void bind_pack_shapes(nb::handle gaussians, nb::handle tree, const In<float>& curves, const In<int32_t>& rows,
                      const In<float>& dilations, const Out<uint32_t>& out, int threads) {
  const NodeColumns columns = columns_of(gaussians);
  const NodeTree of_tree = {column<int32_t>(tree, "subtree_end"), column<uint8_t>(tree, "depth"), curves.data()};
  nb::gil_scoped_release released;
  pack_shapes(columns, of_tree, rows.data(), dilations.data(), static_cast<int64_t>(rows.size()), out.data(), threads);
}

void bind_pack_colors(nb::handle gaussians, const In<int32_t>& rows, const In<double>& eye, const Out<uint32_t>& out,
                      int threads) {
  const NodeColumns columns = columns_of(gaussians);
  nb::gil_scoped_release released;
  pack_colors(columns, rows.data(), static_cast<int64_t>(rows.size()), eye.data(), out.data(), threads);
}

int64_t bind_keep(const In<int32_t>& rows, const In<int32_t>& slot_after, const Out<int32_t>& stamps, int32_t step,
                  const Out<int32_t>& slots, const Out<int32_t>& out) {
  nb::gil_scoped_release released;
  return keep_slots(rows.data(), static_cast<int64_t>(rows.size()), slot_after.data(), stamps.data(), step, slots.data(),
                    out.data());
}

int64_t bind_release(const In<int32_t>& held, const In<int32_t>& slots, const Out<int32_t>& slot_after, const In<int32_t>& stamps,
                     int32_t step, const Out<int32_t>& out) {
  nb::gil_scoped_release released;
  return release_slots(held.data(), slots.data(), static_cast<int64_t>(held.size()), slot_after.data(), stamps.data(), step,
                       out.data());
}

int64_t bind_stale(const In<int32_t>& slots, const In<float>& means, const In<float>& eyes, const In<double>& eye,
                   const In<double>& centre, double share, int64_t first, int64_t limit, const Out<int32_t>& out) {
  nb::gil_scoped_release released;
  return stale_slots(slots.data(), static_cast<int64_t>(slots.size()), {means.data(), eyes.data(), nullptr, nullptr}, eye.data(),
                     centre.data(), share, first, limit, out.data());
}

int64_t bind_drifted(const In<int32_t>& slots, const In<float>& means, const In<float>& limits, const In<float>& dilations,
                     const In<double>& plane, double unit, double factor, const Out<int32_t>& out, const Out<float>& now) {
  nb::gil_scoped_release released;
  return drifted_slots(slots.data(), static_cast<int64_t>(slots.size()), {means.data(), nullptr, limits.data(), dilations.data()},
                       plane.data(), unit, factor, out.data(), now.data());
}

}  // namespace

void bind_nodes(nb::module_& m) {
  m.def("pack_nodes", &bind_pack_nodes, "gaussians"_a, "tree"_a, "curves"_a.none(), "rows"_a, "dilations"_a.none(), "eye"_a,
        "centre"_a, "out"_a, "threads"_a = 0);
  m.def("pack_shapes", &bind_pack_shapes, "gaussians"_a, "tree"_a, "curves"_a, "rows"_a, "dilations"_a, "out"_a, "threads"_a = 0);
  m.def("pack_colors", &bind_pack_colors, "gaussians"_a, "rows"_a, "eye"_a, "out"_a, "threads"_a = 0);
  m.def("keep_slots", &bind_keep, "rows"_a, "slot_after"_a, "stamps"_a, "step"_a, "slots"_a, "out"_a);
  m.def("release_slots", &bind_release, "held"_a, "slots"_a, "slot_after"_a, "stamps"_a, "step"_a, "out"_a);
  m.def("stale_slots", &bind_stale, "slots"_a, "means"_a, "eyes"_a, "eye"_a, "centre"_a, "share"_a, "first"_a, "limit"_a,
        "out"_a);
  m.def("drifted_slots", &bind_drifted, "slots"_a, "means"_a, "limits"_a, "dilations"_a, "plane"_a, "unit"_a, "factor"_a, "out"_a,
        "now"_a);
}

}  // namespace splatree
