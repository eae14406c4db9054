// Glue of the pixels of SOG: arrays are made and checked in sog.py.
#include "cpu/arrays.h"
#include "cpu/sog.h"

namespace splatree {
namespace {

void bind_encode(const In<float>& means, const In<float>& quats, const In<float>& log_scales,
                 const In<float>& logit_opacities, const In<float>& sh, const In<int32_t>& order,
                 const In<double>& mean_ranges, const In<float>& scale_bounds, const In<float>& dc_bounds,
                 const Out<uint8_t>& means_l, const Out<uint8_t>& means_u, const Out<uint8_t>& quats_pixels,
                 const Out<uint8_t>& scales, const Out<uint8_t>& sh0, int threads) {
  const SogEncodeJob job{static_cast<int64_t>(order.shape(0)),
                         static_cast<int64_t>(sh.shape(1) * sh.shape(2)),
                         means.data(),
                         quats.data(),
                         log_scales.data(),
                         logit_opacities.data(),
                         sh.data(),
                         order.data(),
                         mean_ranges.data(),
                         scale_bounds.data(),
                         dc_bounds.data(),
                         means_l.data(),
                         means_u.data(),
                         scales.data(),
                         quats_pixels.data(),
                         sh0.data()};
  nb::gil_scoped_release released;
  encode_sog(job, threads);
}

void bind_find_codes(const In<float>& values, const In<float>& bounds, const Out<uint8_t>& codes, int threads) {
  nb::gil_scoped_release released;
  find_codes(values.data(), static_cast<int64_t>(values.size()), bounds.data(), codes.data(), threads);
}

}  // namespace

void bind_sog(nb::module_& m) {
  m.def("encode_sog", &bind_encode);
  m.def("find_codes", &bind_find_codes);
}

}  // namespace splatree
