// Glue of thinning and merging: array checks are in thin.py and merge.py.
#include <nanobind/stl/optional.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/tuple.h>

#include <optional>
#include <string>
#include <tuple>

#include "cpu/build/merge.h"
#include "cpu/build/pairs.h"
#include "cpu/build/thin.h"
#include "cpu/build/visibility.h"
#include "cpu/runtime/arrays.h"

namespace splatree {
namespace {

std::tuple<int, int64_t> thin_rows(In<float> means, In<float> colors, In<float> importance, double radius,
                                   double color_radius, bool assign, Out<int32_t> representative_from_row,
                                   int threads) {
  ThinJob job{static_cast<int64_t>(means.shape(0)), means.data(), colors.data(), importance.data(), radius,
              color_radius, representative_from_row.data(), assign, 0, 0, threads};
  nb::gil_scoped_release release;
  thin(job);
  return {job.rounds, job.num_visited};
}

void merge_groups(In<float> means, In<float> quats, In<float> log_scales, In<float> logit_opacities, In<float> sh,
                  In<float> weights, In<int64_t> start, In<int32_t> rows, In<int32_t> representatives,
                  const std::string& rule, const std::string& opacity, bool keep_position, double scale_bound,
                  double widening, double mass_limit, double dilation, double added,
                  std::optional<In<float>> opacities, Out<float> out_means, Out<float> out_quats,
                  Out<float> out_log_scales, Out<float> out_logit_opacities, Out<float> out_sh, int threads) {
  MergeJob job{static_cast<int64_t>(representatives.shape(0)),
               static_cast<int64_t>(sh.shape(1)),
               {means.data(), quats.data(), log_scales.data(), logit_opacities.data(), sh.data()},
               weights.data(),
               start.data(),
               rows.data(),
               representatives.data(),
               rule == "mean" ? MergeRule::kMean : MergeRule::kMoments,
               opacity == "union"  ? OpacityRule::kUnion
               : opacity == "mass" ? OpacityRule::kMass
               : opacity == "optical" ? OpacityRule::kOptical
                                   : OpacityRule::kStandard,
               keep_position,
               scale_bound,
               widening,
               mass_limit,
               dilation,
               added,
               opacities ? opacities->data() : nullptr,
               out_means.data(),
               out_quats.data(),
               out_log_scales.data(),
               out_logit_opacities.data(),
               out_sh.data(),
               threads};
  nb::gil_scoped_release release;
  merge(job);
}

}  // namespace

void bind_thin(nb::module_& m) {
  m.def("thin", &thin_rows);
  m.def("merge", &merge_groups);
  m.def("nearest_distances",
        [](In<float> means, In<int32_t> queries, double edge, Out<double> distances, int threads) {
          nb::gil_scoped_release release;
          nearest_distances(static_cast<int64_t>(means.shape(0)), means.data(), static_cast<int64_t>(queries.shape(0)),
                            queries.data(), edge, distances.data(), threads);
        });
  m.def("best_partners", [](In<float> means, In<float> quats, In<float> log_scales, In<float> logit_opacities, In<float> sh,
                            In<float> weights, std::optional<In<float>> visibilities, double dilation,
                            Out<int32_t> partner_from_row, Out<float> costs, Out<float> opacities,
                            int threads) {
    PairJob job{static_cast<int64_t>(means.shape(0)), means.data(), quats.data(), log_scales.data(),
                logit_opacities.data(), sh.data(), weights.data(), visibilities ? visibilities->data() : nullptr,
                static_cast<int64_t>(sh.shape(1)), dilation, partner_from_row.data(), costs.data(), opacities.data(),
                threads};
    nb::gil_scoped_release release;
    best_partners(job);
  });
  m.def("measure_visibilities", [](In<float> means, In<float> quats, In<float> log_scales, In<float> logit_opacities,
                                   In<double> middle, double cell, double reach, int64_t width, Out<float> visibilities,
                                   int threads) {
    const VisibilityJob job{static_cast<int64_t>(means.shape(0)), means.data(), quats.data(), log_scales.data(),
                            logit_opacities.data(), middle.data(), cell, reach, width, visibilities.data(), threads};
    nb::gil_scoped_release release;
    measure_visibilities(job);
  });
  m.def("match_pairs", [](In<int32_t> partner_from_row, In<float> costs, int64_t max_pairs,
                          Out<int32_t> representative_from_row, int threads) {
    nb::gil_scoped_release release;
    return match_pairs(static_cast<int64_t>(costs.shape(0)), partner_from_row.data(), costs.data(), max_pairs,
                       representative_from_row.data(), threads);
  });
  m.def("group_rows", [](In<int32_t> group_from_row, int64_t num_groups, Out<int64_t> start, Out<int32_t> rows) {
    nb::gil_scoped_release release;
    group_rows(static_cast<int64_t>(group_from_row.shape(0)), group_from_row.data(), num_groups, start.data(),
               rows.data());
  });
  m.def("average_children",
        [](In<int32_t> subtree_end, In<float> weights, Out<float> values, int64_t width, int threads) {
          nb::gil_scoped_release release;
          average_children(static_cast<int64_t>(subtree_end.shape(0)), width, subtree_end.data(), weights.data(),
                           values.data(), threads);
        });
}

}  // namespace splatree
