// Glue of the clusters: K-means and spheres. Sizes are checked by the callers in kernels/cpu/build/*.py.
#include "cpu/build/clusters.h"
#include "cpu/build/kmeans.h"
#include "cpu/runtime/arrays.h"
#include "cpu/runtime/isa.h"
#include "cpu/runtime/pool.h"

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

void bound_clusters(In<float> means, In<float> quats, In<float> log_scales, In<float> logit_opacities, In<int32_t> start,
                    In<float> centers, Out<float> radii, Out<float> mean_radii, Out<float> footprint_radii, Out<float> box_low,
                    Out<float> box_high, int threads) {
  const SpheresJob job{means.data(),           quats.data(),   log_scales.data(), logit_opacities.data(),
                       start.data(),           centers.data(), radii.data(),      mean_radii.data(),
                       footprint_radii.data(), box_low.data(), box_high.data()};
  const int64_t num_clusters = int64_t(centers.shape(0));
  nb::gil_scoped_release release;
  parallel_ranges(num_clusters, 64, threads, [&](int64_t begin, int64_t end) { kernels().bound_spheres(job, begin, end); });
}

}  // namespace

void bind_clusters(nb::module_& m) {
  m.def("kmeans", &kmeans, "Fill the nearest centre of each point, and the sum and number of each centre's points.");
  m.def("bound_spheres", &bound_clusters, "Fill the radii of clusters around their centres, and their boxes.");
}

}  // namespace splatree
