// Glue of the partners that are kept while levels grow by pairs: array checks are in partners.py.
#include "cpu/build/partners.h"
#include "cpu/runtime/arrays.h"

namespace splatree {
namespace {

template <class T>
const T* read(nb::handle object, const char* name) {
  return nb::cast<In<T>>(object.attr(name)).data();
}

template <class T>
T* written(nb::handle object, const char* name) {
  return nb::cast<Out<T>>(object.attr(name)).data();
}

PartnerColumns columns_of(nb::handle partners) {
  return {written<int32_t>(partners, "neighbors"), written<int32_t>(partners, "rows"), written<float>(partners, "costs"),
          written<float>(partners, "opacities"),   written<float>(partners, "sigmas"), written<uint8_t>(partners, "is_stale")};
}

}  // namespace

void bind_partners(nb::module_& m) {
  m.def("find_neighbors", [](In<float> means, nb::handle partners, int threads) {
    const PartnerColumns columns = columns_of(partners);
    const int64_t n = static_cast<int64_t>(means.shape(0));
    nb::gil_scoped_release release;
    find_neighbors(n, means.data(), columns, threads);
  });
  m.def("find_partners",
        [](nb::handle gaussians, In<float> weights, In<float> visibilities, double dilation, nb::handle partners, int threads) {
          const auto sh = nb::cast<In<float>>(gaussians.attr("sh"));
          const PairJob job{static_cast<int64_t>(weights.shape(0)),
                            read<float>(gaussians, "means"),
                            read<float>(gaussians, "quats"),
                            read<float>(gaussians, "log_scales"),
                            read<float>(gaussians, "logit_opacities"),
                            sh.data(),
                            weights.data(),
                            visibilities.data(),
                            static_cast<int64_t>(sh.shape(1)),
                            dilation,
                            nullptr,
                            nullptr,
                            nullptr,
                            threads};
          const PartnerColumns columns = columns_of(partners);
          nb::gil_scoped_release release;
          find_partners(job, columns);
        });
  m.def("carry_partners", [](nb::handle groups, In<float> means, nb::handle from, nb::handle to, int threads) {
    const PairGroups pairs{static_cast<int64_t>(means.shape(0)), read<int64_t>(groups, "start"), read<int32_t>(groups, "rows"),
                           read<int32_t>(groups, "representatives"), read<int32_t>(groups, "group_from_row")};
    const PartnerColumns before = columns_of(from), after = columns_of(to);
    nb::gil_scoped_release release;
    carry_partners(pairs, means.data(), before, after, threads);
  });
}

}  // namespace splatree
