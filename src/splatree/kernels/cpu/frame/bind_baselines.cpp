// Glue of the published methods' rules; sizes are checked by kernels/cpu/frame/baselines.py.
#include "cpu/frame/baselines.h"
#include "cpu/runtime/arrays.h"

namespace splatree {
namespace {

void nest(In<uint8_t> depth, Out<float> lower, Out<float> upper) {
  nb::gil_scoped_release release;
  nest_boxes(depth.data(), int64_t(depth.shape(0)), lower.data(), upper.data());
}

void small_boxes(In<float> lower, In<float> upper, In<float> eye, float limit, Out<uint8_t> small, int threads) {
  nb::gil_scoped_release release;
  flag_small_boxes(lower.data(), upper.data(), int64_t(lower.shape(0)), eye.data(), limit, threads, small.data());
}

void depth_flags(In<float> means, In<uint8_t> depth, In<float> eye, In<float> squared_edges, In<int32_t> depths,
                 Out<uint8_t> flags, int threads) {
  const DistanceBands bands{squared_edges.data(), depths.data(), int(depths.shape(0))};
  nb::gil_scoped_release release;
  flag_depths(means.data(), depth.data(), int64_t(means.shape(0)), eye.data(), bands, threads, flags.data());
}

int64_t stops(In<uint8_t> flags, In<int32_t> subtree_end, int least, Out<int32_t> rows) {
  nb::gil_scoped_release release;
  return first_stops(flags.data(), subtree_end.data(), int64_t(flags.shape(0)), uint8_t(least), rows.data());
}

}  // namespace

void bind_baselines(nb::module_& m) {
  m.def("nest_boxes", &nest, "Widen the box of each row to hold those below it.");
  m.def("small_boxes", &small_boxes, "Whether each box is small from the eye.");
  m.def("depth_flags", &depth_flags, "Where each row lies to the depth that its distance asks for.");
  m.def("first_stops", &stops, "The first rows on all paths that stop; returns how many.");
}

}  // namespace splatree
