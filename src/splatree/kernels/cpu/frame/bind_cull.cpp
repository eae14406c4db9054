// Glue of culling clusters. Sizes are checked by the caller, kernels/cpu/frame/cull.py.
#include <algorithm>

#include "cpu/frame/cull.h"
#include "cpu/runtime/isa.h"
#include "cpu/runtime/pool.h"
#include "cpu/runtime/scene.h"

namespace splatree {
namespace {

constexpr int64_t CLUSTERS_AT_LEAST = 16384;  // of a thread that culls: fewer are done before another has woken up

// The borders of the view, alike in both jobs.
template <class Job>
Job job_of(const py::Sides& sides, Out<bool>& kept) {
  Job job{};
  std::copy_n(column<double>(sides, "planes"), 4 * CULL_SIDES, &job.plane[0][0]);
  std::copy_n(column<double>(sides, "reaches"), CULL_SIDES, job.reach);
  std::copy_n(column<double>(sides, "eye"), 3, job.eye);
  job.slack = number<double>(sides, "slack"), job.margin = number<double>(sides, "margin");
  job.kept = reinterpret_cast<uint8_t*>(kept.data());
  return job;
}

void cull_clusters(In<float> centers, In<float> radii, In<float> near_radii, py::Sides sides, Out<bool> kept, int threads) {
  CullJob job = job_of<CullJob>(sides, kept);
  job.centers = centers.data(), job.radii = radii.data(), job.near_radii = near_radii.data();
  job.scale = number<double>(sides, "scale");
  job.guard = number<bool>(sides, "guard");
  const int64_t num_clusters = int64_t(centers.shape(0));
  nb::gil_scoped_release release;
  parallel_ranges(num_clusters, CLUSTERS_AT_LEAST, threads,
                  [&](int64_t begin, int64_t end) { kernels().cull_spheres(job, begin, end); });
}

void cull_cluster_boxes(In<float> low, In<float> high, py::Sides sides, Out<bool> kept, int threads) {
  CullBoxesJob job = job_of<CullBoxesJob>(sides, kept);
  job.low = low.data(), job.high = high.data();
  std::copy_n(column<double>(sides, "box_reaches"), 3 * CULL_SIDES, &job.box_reach[0][0]);
  const int64_t num_clusters = int64_t(low.shape(0));
  nb::gil_scoped_release release;
  parallel_ranges(num_clusters, CLUSTERS_AT_LEAST, threads,
                  [&](int64_t begin, int64_t end) { kernels().cull_boxes(job, begin, end); });
}

}  // namespace

void bind_cull(nb::module_& m) {
  m.def("cull_spheres", &cull_clusters, nb::arg("centers"), nb::arg("radii"), nb::arg("near_radii"), nb::arg("sides"),
        nb::arg("kept"), nb::arg("threads"), "Fill whether each sphere can be seen.");
  m.def("cull_boxes", &cull_cluster_boxes, nb::arg("low"), nb::arg("high"), nb::arg("sides"), nb::arg("kept"), nb::arg("threads"),
        "Fill whether each box can be seen.");
}

}  // namespace splatree
