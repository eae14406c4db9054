// Glue of growth by pairs: array checks are in partners.py and level.py.
#include "cpu/build/bind_merge.h"
#include "cpu/build/level.h"
#include "cpu/build/partners.h"
#include "cpu/runtime/structs.h"

namespace splatree {
namespace {

PartnerColumns columns_of(nb::handle partners) {
  return {out_column<int32_t>(partners, "neighbors"),  out_column<int32_t>(partners, "rows"),
          out_column<float>(partners, "costs"),        out_column<float>(partners, "opacities"),
          out_column<float>(partners, "least_sigmas"), out_column<uint8_t>(partners, "states")};
}

// The structs are those of Python: LevelLimits.
LevelLimits limits_of(nb::handle limits) {
  const auto number = [&](const char* field) { return nb::cast<double>(limits.attr(field)); };
  LevelLimits found{};
  found.cost = number("cost");
  found.sigma = static_cast<float>(number("sigma"));
  found.small_sigma = static_cast<float>(number("small_sigma"));
  found.saturated = static_cast<float>(number("saturated"));
  found.dilation = number("dilation");
  found.round_share = number("round_share");
  found.last_share = number("last_share");
  found.num_enough = nb::cast<int64_t>(limits.attr("num_enough"));
  return found;
}

}  // namespace

void bind_partners(nb::module_& m) {
  m.def("find_neighbors", [](In<float> means, nb::handle partners, int threads) {
    const PartnerColumns columns = columns_of(partners);
    const int64_t n = static_cast<int64_t>(means.shape(0));
    nb::gil_scoped_release release;
    find_neighbors(n, means.data(), columns, threads);
  });
  m.def("keep_partners", [](In<uint8_t> is_kept, nb::handle from, nb::handle to, int threads) {
    const PartnerColumns before = columns_of(from), after = columns_of(to);
    nb::gil_scoped_release release;
    keep_partners(static_cast<int64_t>(is_kept.shape(0)), is_kept.data(), before, after, threads);
  });
  m.def("find_partners",
        [](nb::handle gaussians, In<float> weights, In<float> visibilities, nb::handle partners, double dilation, int threads) {
          LevelJob job{};
          job.n = static_cast<int64_t>(weights.shape(0));
          // Nothing but the partners is written.
          job.means = const_cast<float*>(column<float>(gaussians, "means"));
          job.quats = const_cast<float*>(column<float>(gaussians, "quats"));
          job.log_scales = const_cast<float*>(column<float>(gaussians, "log_scales"));
          job.logit_opacities = const_cast<float*>(column<float>(gaussians, "logit_opacities"));
          job.sh = const_cast<float*>(column<float>(gaussians, "sh"));
          job.weights = const_cast<float*>(weights.data());
          job.visibilities = const_cast<float*>(visibilities.data());
          job.partners = columns_of(partners);
          job.rules.k = int64_t(nb::cast<In<float>>(gaussians.attr("sh")).shape(1));
          job.limits.dilation = dilation;
          job.threads = threads;
          nb::gil_scoped_release release;
          find_partners(job);
        });
  m.def(
      "merge_level",
      [](nb::handle gaussians, Out<float> weights, Out<float> visibilities, nb::handle partners, nb::handle options, double added,
         nb::handle limits, In<uint8_t> is_frozen, Out<int32_t> row_from_row, int threads) {
        LevelJob job{};
        job.n = static_cast<int64_t>(weights.shape(0));
        job.means = out_column<float>(gaussians, "means");
        job.quats = out_column<float>(gaussians, "quats");
        job.log_scales = out_column<float>(gaussians, "log_scales");
        job.logit_opacities = out_column<float>(gaussians, "logit_opacities");
        job.sh = out_column<float>(gaussians, "sh");
        job.weights = weights.data();
        job.visibilities = visibilities.data();
        job.partners = columns_of(partners);
        job.rules = merge_job_of(options);
        job.rules.k = int64_t(nb::cast<In<float>>(gaussians.attr("sh")).shape(1));
        job.rules.added = added;
        job.limits = limits_of(limits);
        job.is_frozen = is_frozen.data();
        job.row_from_row = row_from_row.data();
        job.threads = threads;
        nb::gil_scoped_release release;
        return merge_level(job);
      },
      nb::arg("gaussians"), nb::arg("weights"), nb::arg("visibilities"), nb::arg("partners"), nb::arg("options"),
      nb::arg("added"), nb::arg("limits"), nb::arg("is_frozen"), nb::arg("row_from_row"), nb::arg("threads"));
}

}  // namespace splatree
