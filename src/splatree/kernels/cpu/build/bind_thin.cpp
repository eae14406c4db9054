// Glue of thinning and merging: array checks are in thin.py and merge.py.
#include <nanobind/stl/optional.h>
#include <nanobind/stl/tuple.h>

#include <optional>
#include <string>
#include <tuple>

#include "cpu/build/bind_merge.h"
#include "cpu/build/curves.h"
#include "cpu/build/merge.h"
#include "cpu/build/pairs.h"
#include "cpu/build/thin.h"
#include "cpu/build/visibility.h"
#include "cpu/runtime/isa.h"
#include "cpu/runtime/pool.h"
#include "cpu/runtime/scratch.h"
#include "cpu/runtime/structs.h"

namespace splatree {
namespace {

GaussianColumns columns_of(nb::handle gaussians) {
  return {column<float>(gaussians, "means"), column<float>(gaussians, "quats"), column<float>(gaussians, "log_scales"),
          column<float>(gaussians, "logit_opacities"), column<float>(gaussians, "sh")};
}

int64_t num_coefficients(nb::handle gaussians) { return int64_t(nb::cast<In<float>>(gaussians.attr("sh")).shape(1)); }

// The struct is that of Python: Gaussians.
PairJob pair_job_of(nb::handle gaussians, const float* weights, const float* visibilities, double dilation, int threads) {
  const GaussianColumns in = columns_of(gaussians);
  PairJob job{};
  job.n = int64_t(nb::len(gaussians));
  job.means = in.means, job.quats = in.quats, job.log_scales = in.log_scales;
  job.logit_opacities = in.logit_opacities, job.sh = in.sh;
  job.weights = weights;
  job.visibilities = visibilities;
  job.k = num_coefficients(gaussians);
  job.dilation = dilation;
  job.threads = threads;
  return job;
}

// The struct is that of Python: MergeLimit.
std::tuple<int, int64_t> thin_rows(In<float> means, In<float> colors, In<float> importance, double radius, double color_radius,
                                   std::optional<In<uint8_t>> is_open, bool assign, nb::handle limit,
                                   Out<int32_t> representative_from_row, int threads) {
  ThinJob job{};
  job.n = static_cast<int64_t>(means.shape(0));
  job.means = means.data(), job.colors = colors.data(), job.importance = importance.data();
  job.radius = radius, job.color_radius = color_radius;
  job.is_open = is_open ? is_open->data() : nullptr;
  job.representative_from_row = representative_from_row.data();
  job.assign = assign;
  job.threads = threads;
  PairJob pairs{};
  if (!limit.is_none()) {
    pairs =
        pair_job_of(limit.attr("gaussians"), column<float>(limit, "weights"), column<float>(limit, "visibilities"), 0, threads);
    job.most = float(nb::cast<double>(limit.attr("most")));
  }
  nb::gil_scoped_release release;
  Scratch<PairRecord> records = allocate<PairRecord>(pairs.n);
  parallel_ranges(pairs.n, 1 << 13, threads, [&](int64_t begin, int64_t end) {
    for (int64_t row = begin; row < end; ++row) records[row] = record_of(pairs, row);
  });
  if (pairs.n) job.records = records.get();
  thin(job);
  return {job.rounds, job.num_visited};
}

constexpr Choice<MergeRule> MERGE_RULES[] = {{"mean", MergeRule::MEAN}, {"moments", MergeRule::MOMENTS}};

// `fitted` merges like `standard`: the opacities that were fitted come from the caller.
constexpr Choice<OpacityRule> OPACITY_RULES[] = {{"union", OpacityRule::UNION},
                                                 {"mass", OpacityRule::MASS},
                                                 {"standard", OpacityRule::STANDARD},
                                                 {"fitted", OpacityRule::STANDARD},
                                                 {"optical", OpacityRule::OPTICAL}};

constexpr Choice<bool> KEEPS_POSITION[] = {{"centroid", false}, {"representative", true}};

// The structs are those of Python: Gaussians, Sight.
VisibilityJob job_of_sight(nb::handle sight, int threads) {
  VisibilityJob job{};
  job.middle = nb::cast<In<double>>(sight.attr("middle")).data();
  job.cell = nb::cast<double>(sight.attr("cell"));
  job.reach = nb::cast<double>(sight.attr("reach"));
  job.width = nb::cast<int64_t>(sight.attr("width"));
  job.threads = threads;
  return job;
}

VisibilityJob visibility_job(nb::handle gaussians, nb::handle sight, int threads) {
  VisibilityJob job = job_of_sight(sight, threads);
  const GaussianColumns in = columns_of(gaussians);
  job.n = int64_t(nb::len(gaussians));
  job.means = in.means, job.quats = in.quats, job.log_scales = in.log_scales, job.logit_opacities = in.logit_opacities;
  return job;
}

// The structs are those of Python: Gaussians, Groups, MergeOptions (resolved), and the Gaussians to fill.
void merge_groups(nb::handle gaussians, nb::handle groups, In<float> weights, nb::handle options, double added,
                  std::optional<In<float>> opacities, nb::handle out, int threads) {
  MergeJob job = merge_job_of(options);
  job.num_groups = int64_t(nb::len(groups));
  job.k = num_coefficients(gaussians);
  job.in = columns_of(gaussians);
  job.weights = weights.data();
  job.start = column<int64_t>(groups, "start");
  job.rows = column<int32_t>(groups, "rows");
  job.representatives = column<int32_t>(groups, "representatives");
  job.added = added;
  job.opacities = opacities ? opacities->data() : nullptr;
  job.means = out_column<float>(out, "means");
  job.quats = out_column<float>(out, "quats");
  job.log_scales = out_column<float>(out, "log_scales");
  job.logit_opacities = out_column<float>(out, "logit_opacities");
  job.sh = out_column<float>(out, "sh");
  job.threads = threads;
  nb::gil_scoped_release release;
  merge(job);
}

CurvesJob curves_job_of(nb::handle gaussians, In<int32_t> subtree_end, int threads) {
  CurvesJob job{};
  job.n = int64_t(nb::len(gaussians));
  job.subtree_end = subtree_end.data();
  job.means = out_column<float>(gaussians, "means");
  job.quats = out_column<float>(gaussians, "quats");
  job.log_scales = out_column<float>(gaussians, "log_scales");
  job.logit_opacities = out_column<float>(gaussians, "logit_opacities");
  job.threads = threads;
  return job;
}

void fit_rows(nb::handle gaussians, In<int32_t> subtree_end, In<float> seen, double dilation_share, In<float> extents,
              double kept_extent, double kept_dilation, double least_dilation, Out<float> curves, int threads) {
  CurvesJob job = curves_job_of(gaussians, subtree_end, threads);
  job.seen = seen.data();
  job.extents = extents.data();
  job.dilation_share = dilation_share;
  job.kept_extent = kept_extent, job.kept_dilation = kept_dilation, job.least_dilation = least_dilation;
  job.curves = curves.data();
  nb::gil_scoped_release release;
  fit_curves(job);
}

void fit_rows_above(nb::handle gaussians, In<int32_t> subtree_end, In<double> below, double dilation_share, double least_dilation,
                    In<float> extents, In<double> sums, Out<float> curves, int threads) {
  CurvesJob job = curves_job_of(gaussians, subtree_end, threads);
  job.below = below.data();
  job.extents = extents.data();
  job.dilation_share = dilation_share, job.least_dilation = least_dilation;
  job.sums = sums.data();
  job.curves = curves.data();
  nb::gil_scoped_release release;
  fit_curves(job);
}

// The rows are only read.
CurvesJob moments_job_of(nb::handle gaussians, In<int32_t> subtree_end, int threads) {
  CurvesJob job{};
  job.n = int64_t(nb::len(gaussians));
  job.subtree_end = subtree_end.data();
  job.means = const_cast<float*>(column<float>(gaussians, "means"));
  job.quats = const_cast<float*>(column<float>(gaussians, "quats"));
  job.log_scales = const_cast<float*>(column<float>(gaussians, "log_scales"));
  job.logit_opacities = const_cast<float*>(column<float>(gaussians, "logit_opacities"));
  job.threads = threads;
  return job;
}

void moments_of_roots(nb::handle gaussians, In<int32_t> subtree_end, std::optional<In<float>> seen,
                      std::optional<In<double>> below, Out<double> moments, int threads) {
  CurvesJob job = moments_job_of(gaussians, subtree_end, threads);
  job.seen = seen ? seen->data() : nullptr;
  job.below = below ? below->data() : nullptr;
  nb::gil_scoped_release release;
  root_moments(job, moments.data());
}

void add_shown_by_leaves(In<float> log_scales, In<float> logit_opacities, In<float> seen, int64_t first, In<int64_t> begin,
                         In<int64_t> end, In<double> dilations, Out<double> sums, int threads) {
  ShownJob job{};
  job.first = first, job.n = int64_t(seen.shape(0)), job.num_nodes = int64_t(begin.shape(0));
  job.log_scales = log_scales.data(), job.logit_opacities = logit_opacities.data(), job.seen = seen.data();
  job.begin = begin.data(), job.end = end.data();
  job.dilations = dilations.data();
  job.sums = sums.data();
  job.threads = threads;
  nb::gil_scoped_release release;
  add_shown(job);
}

}  // namespace

MergeJob merge_job_of(nb::handle options) {
  const auto named = [&](const char* field) { return nb::cast<std::string>(options.attr(field)); };
  const auto number = [&](const char* field) { return nb::cast<double>(options.attr(field)); };
  MergeJob job{};
  job.rule = chosen(named("rule"), "rule", MERGE_RULES);
  job.opacity = chosen(named("opacity"), "opacity", OPACITY_RULES);
  job.keep_position = chosen(named("position"), "position", KEEPS_POSITION);
  job.scale_bound = number("bound");
  job.widening = number("power");
  job.mass_limit = number("mass_limit");
  job.dilation = options.attr("dilation").is_none() ? 0.0 : number("dilation");
  return job;
}

void bind_thin(nb::module_& m) {
  m.def("thin", &thin_rows, nb::arg("means"), nb::arg("colors"), nb::arg("importance"), nb::arg("radius"),
        nb::arg("color_radius"), nb::arg("is_open").none(), nb::arg("assign"), nb::arg("limit").none(),
        nb::arg("representative_from_row"), nb::arg("threads"));
  m.def("merge", &merge_groups, nb::arg("gaussians"), nb::arg("groups"), nb::arg("weights"), nb::arg("options"), nb::arg("added"),
        nb::arg("opacities").none(), nb::arg("out"), nb::arg("threads"), "Fill `out` with one Gaussian for each group.");
  m.def("nearest_distances", [](In<float> means, In<int32_t> queries, double edge, Out<double> distances, int threads) {
    nb::gil_scoped_release release;
    nearest_distances(static_cast<int64_t>(means.shape(0)), means.data(), static_cast<int64_t>(queries.shape(0)), queries.data(),
                      edge, distances.data(), threads);
  });
  m.def(
      "best_partners",
      [](nb::handle gaussians, In<float> weights, std::optional<In<float>> visibilities, double dilation,
         Out<int32_t> partner_from_row, Out<float> costs, Out<float> opacities, int threads) {
        PairJob job = pair_job_of(gaussians, weights.data(), visibilities ? visibilities->data() : nullptr, dilation, threads);
        job.partner_from_row = partner_from_row.data();
        job.costs = costs.data();
        job.opacities = opacities.data();
        nb::gil_scoped_release release;
        best_partners(job);
      },
      nb::arg("gaussians"), nb::arg("weights"), nb::arg("visibilities").none(), nb::arg("dilation"), nb::arg("partner"),
      nb::arg("costs"), nb::arg("opacities"), nb::arg("threads"));
  m.def("measure_visibilities", [](nb::handle gaussians, nb::handle sight, Out<float> visibilities, int threads) {
    VisibilityJob job = visibility_job(gaussians, sight, threads);
    job.visibilities = visibilities.data();
    nb::gil_scoped_release release;
    measure_visibilities(job);
  });
  m.def("depths_along", [](In<float> means, nb::handle sight, int64_t axis, Out<float> depths, int threads) {
    VisibilityJob job = job_of_sight(sight, threads);
    job.n = int64_t(means.shape(0)), job.means = means.data();
    nb::gil_scoped_release release;
    depths_along(job, axis, depths.data());
  });
  m.def("steps_of_depths", [](In<float> depths, float nearest, float farthest, Out<uint32_t> steps) {
    nb::gil_scoped_release release;
    steps_of_depths(static_cast<int64_t>(depths.shape(0)), depths.data(), nearest, farthest, steps.data());
  });
  m.def("sighted_along", [](nb::handle gaussians, nb::handle sight, int64_t axis, Out<float> splats, int threads) {
    const VisibilityJob job = visibility_job(gaussians, sight, threads);
    nb::gil_scoped_release release;
    sighted_along(job, axis, reinterpret_cast<Sighted*>(splats.data()));
  });
  m.def("see_through", [](Out<float> splats, nb::handle sight, bool backwards, Out<float> passing, Out<float> depths) {
    const auto width = nb::cast<int64_t>(sight.attr("width"));
    const auto inverse_reach = float(nb::cast<double>(sight.attr("cell")) / nb::cast<double>(sight.attr("reach")));
    Sighted* const first = reinterpret_cast<Sighted*>(splats.data());
    const auto count = int64_t(splats.shape(0));
    nb::gil_scoped_release release;
    kernels().see_through({first, count, backwards, width, passing.data(), depths.data(), inverse_reach});
  });
  m.def("match_pairs",
        [](In<int32_t> partner_from_row, In<float> costs, int64_t max_pairs, Out<int32_t> representative_from_row, int threads) {
          nb::gil_scoped_release release;
          return match_pairs(static_cast<int64_t>(costs.shape(0)), partner_from_row.data(), costs.data(), max_pairs,
                             representative_from_row.data(), threads);
        });
  m.def("group_rows", [](In<int32_t> group_from_row, int64_t num_groups, Out<int64_t> start, Out<int32_t> rows) {
    nb::gil_scoped_release release;
    group_rows(static_cast<int64_t>(group_from_row.shape(0)), group_from_row.data(), num_groups, start.data(), rows.data());
  });
  m.def("average_children", [](In<int32_t> subtree_end, In<float> weights, Out<float> values, int64_t width, int threads) {
    nb::gil_scoped_release release;
    average_children(static_cast<int64_t>(subtree_end.shape(0)), width, subtree_end.data(), weights.data(), values.data(),
                     threads);
  });
  m.def("fit_curves", &fit_rows, nb::arg("gaussians"), nb::arg("subtree_end"), nb::arg("seen"), nb::arg("dilation_share"),
        nb::arg("extents"), nb::arg("kept_extent"), nb::arg("kept_dilation"), nb::arg("least_dilation"), nb::arg("curves"),
        nb::arg("threads"), "Overwrite the inner nodes, and fill their curves.");
  m.def("fit_curves_above", &fit_rows_above, "As fit_curves, of rows whose leaves stand for others.");
  m.def("root_moments", &moments_of_roots, nb::arg("gaussians"), nb::arg("subtree_end"), nb::arg("seen").none(),
        nb::arg("below").none(), nb::arg("moments"), nb::arg("threads"), "Moments of each root.");
  m.def("add_shown", &add_shown_by_leaves, "Add what leaves show at the dilations of the nodes above them.");
}

}  // namespace splatree
