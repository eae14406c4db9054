// Glue of the clusters: K-means. Sizes are checked by the callers in kernels/cpu/*.py.
#include "cpu/arrays.h"
#include "cpu/kmeans.h"

namespace splatree {
namespace {

void kmeans(In<float> points, In<float> centers, Out<int32_t> labels, Out<float> squared_distances, Out<double> sums,
            Out<int64_t> counts, int threads) {
  const KmeansJob job{points.data(), int64_t(points.shape(0)), centers.data(), int32_t(centers.shape(0)), threads,
                      labels.data(), squared_distances.data(), sums.data(), counts.data()};
  nb::gil_scoped_release release;
  kmeans_step(job);
}

}  // namespace

void bind_clusters(nb::module_& m) {
  m.def("kmeans", &kmeans, "Fill the nearest centre of each point, and the sum and number of each centre's points.");
}

}  // namespace splatree
