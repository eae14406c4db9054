// Glue of the clusters: K-means and spheres. Sizes are checked by the callers in kernels/cpu/build/*.py.
#include "cpu/build/clusters.h"
#include "cpu/build/kmeans.h"
#include "cpu/runtime/isa.h"
#include "cpu/runtime/pool.h"
#include "cpu/runtime/structs.h"

namespace splatree {
namespace {

void kmeans(In<float> points, In<float> centers, Out<int32_t> labels, Out<float> squared_distances, Out<double> sums,
            Out<int64_t> counts, int threads) {
  const KmeansJob job{points.data(),
                      int64_t(points.shape(0)),
                      centers.data(),
                      int32_t(centers.shape(0)),
                      threads,
                      labels.data(),
                      squared_distances.data(),
                      sums.data(),
                      counts.data()};
  nb::gil_scoped_release release;
  kmeans_step(job);
}

// The structs are Gaussians and ClusterIndex of Python; the kernel fills the radii and boxes of the latter.
void bound_clusters(nb::handle gaussians, nb::handle clusters, int threads) {
  SpheresJob job{};
  job.means = column<float>(gaussians, "means");
  job.quats = column<float>(gaussians, "quats");
  job.log_scales = column<float>(gaussians, "log_scales");
  job.logit_opacities = column<float>(gaussians, "logit_opacities");
  job.start = column<int32_t>(clusters, "start");
  job.centers = column<float>(clusters, "centers");
  job.radii = out_column<float>(clusters, "radii");
  job.mean_radii = out_column<float>(clusters, "mean_radii");
  job.footprint_radii = out_column<float>(clusters, "footprint_radii");
  job.box_low = out_column<float>(clusters, "box_low");
  job.box_high = out_column<float>(clusters, "box_high");
  const int64_t num_clusters = int64_t(nb::len(clusters));
  nb::gil_scoped_release release;
  parallel_ranges(num_clusters, 64, threads, [&](int64_t begin, int64_t end) { kernels().bound_spheres(job, begin, end); });
}

}  // namespace

void bind_clusters(nb::module_& m) {
  m.def("kmeans", &kmeans, "Fill the nearest centre of each point, and the sum and number of each centre's points.");
  m.def("bound_spheres", &bound_clusters, nb::arg("gaussians"), nb::arg("clusters"), nb::arg("threads"),
        "Fill the radii of clusters around their centres, and their boxes.");
}

}  // namespace splatree
