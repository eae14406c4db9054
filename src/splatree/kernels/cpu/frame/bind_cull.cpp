// Glue of culling clusters. Sizes are checked by the caller, kernels/cpu/frame/cull.py.
#include <algorithm>

#include "cpu/frame/cull.h"
#include "cpu/runtime/arrays.h"
#include "cpu/runtime/isa.h"
#include "cpu/runtime/pool.h"

namespace splatree {
namespace {

constexpr int64_t CLUSTERS_AT_LEAST = 16384;  // of a thread that culls: fewer are done before another has woken up

void cull_clusters(In<float> centers, In<float> radii, In<float> near_radii, In<double> planes, In<double> reaches,
                   In<double> eye, In<double> margins, Out<bool> kept, int threads) {
  CullJob job{};
  job.centers = centers.data(), job.radii = radii.data(), job.near_radii = near_radii.data();
  std::copy_n(planes.data(), 4 * CULL_SIDES, &job.plane[0][0]);
  std::copy_n(reaches.data(), CULL_SIDES, job.reach);
  std::copy_n(eye.data(), 3, job.eye);
  job.scale = margins.data()[0], job.slack = margins.data()[1], job.margin = margins.data()[2];
  job.guard = margins.data()[3] != 0;
  job.kept = reinterpret_cast<uint8_t*>(kept.data());
  const int64_t num_clusters = int64_t(centers.shape(0));
  nb::gil_scoped_release release;
  parallel_ranges(num_clusters, CLUSTERS_AT_LEAST, threads,
                  [&](int64_t begin, int64_t end) { kernels().cull_spheres(job, begin, end); });
}

void cull_cluster_boxes(In<float> low, In<float> high, In<double> planes, In<double> reaches, In<double> box_reaches,
                        In<double> eye, In<double> margins, Out<bool> kept, int threads) {
  CullBoxesJob job{};
  job.low = low.data(), job.high = high.data();
  std::copy_n(planes.data(), 4 * CULL_SIDES, &job.plane[0][0]);
  std::copy_n(reaches.data(), CULL_SIDES, job.reach);
  std::copy_n(box_reaches.data(), 3 * CULL_SIDES, &job.box_reach[0][0]);
  std::copy_n(eye.data(), 3, job.eye);
  job.slack = margins.data()[0], job.margin = margins.data()[1];
  job.kept = reinterpret_cast<uint8_t*>(kept.data());
  const int64_t num_clusters = int64_t(low.shape(0));
  nb::gil_scoped_release release;
  parallel_ranges(num_clusters, CLUSTERS_AT_LEAST, threads,
                  [&](int64_t begin, int64_t end) { kernels().cull_boxes(job, begin, end); });
}

}  // namespace

void bind_cull(nb::module_& m) {
  m.def("cull_spheres", &cull_clusters, "Fill whether each sphere can be seen.");
  m.def("cull_boxes", &cull_cluster_boxes, "Fill whether each box can be seen.");
}

}  // namespace splatree
