// Glue of the pixels of SOG: arrays are made and checked in sog.py.
#include "cpu/codec/sog.h"
#include "cpu/runtime/arrays.h"

namespace splatree {
namespace {

// `labels` and their pixels are empty where there is no palette.
void bind_encode(const In<float>& means, const In<float>& quats, const In<float>& log_scales, const In<float>& logit_opacities,
                 const In<float>& sh, const In<int32_t>& places, const In<int32_t>& labels, const In<double>& mean_ranges,
                 const In<float>& scale_bounds, const In<float>& dc_bounds, const Out<uint8_t>& means_l,
                 const Out<uint8_t>& means_u, const Out<uint8_t>& quats_pixels, const Out<uint8_t>& scales,
                 const Out<uint8_t>& sh0, const Out<uint8_t>& labels_pixels, int threads) {
  SogEncodeJob job{};
  job.num_rows = static_cast<int64_t>(places.shape(0));
  job.sh_stride = static_cast<int64_t>(sh.shape(1) * sh.shape(2));
  job.means = means.data();
  job.quats = quats.data();
  job.log_scales = log_scales.data();
  job.logit_opacities = logit_opacities.data();
  job.sh = sh.data();
  job.places = places.data();
  job.labels = labels.size() > 0 ? labels.data() : nullptr;
  job.mean_ranges = mean_ranges.data();
  job.scale_bounds = scale_bounds.data();
  job.dc_bounds = dc_bounds.data();
  job.means_l = means_l.data();
  job.means_u = means_u.data();
  job.scales = scales.data();
  job.quats_pixels = quats_pixels.data();
  job.sh0 = sh0.data();
  job.labels_pixels = labels_pixels.data();
  nb::gil_scoped_release released;
  encode_sog(job, threads);
}

nb::tuple bind_decode(const In<uint8_t>& means_l, const In<uint8_t>& means_u, const In<uint8_t>& quats_pixels,
                      const In<uint8_t>& scales, const In<uint8_t>& sh0, const In<uint8_t>& labels, const In<float>& mean_tables,
                      const In<float>& scale_tables, const In<float>& dc_tables, const In<float>& logit_table,
                      const In<float>& rest_table, const In<uint8_t>& palette, const Out<float>& means, const Out<float>& quats,
                      const Out<float>& log_scales, const Out<float>& logit_opacities, const Out<float>& sh, int threads) {
  SogDecodeJob job{};
  job.num_rows = static_cast<int64_t>(means.shape(0));
  job.sh_stride = static_cast<int64_t>(sh.shape(1) * sh.shape(2));
  job.means_l = means_l.data();
  job.means_u = means_u.data();
  job.scales = scales.data();
  job.labels = labels.data();
  job.quats_pixels = quats_pixels.data();
  job.sh0 = sh0.data();
  job.mean_tables = mean_tables.data();
  job.scale_tables = scale_tables.data();
  job.dc_tables = dc_tables.data();
  job.logit_table = logit_table.data();
  job.rest_table = rest_table.data();
  job.palette = palette.data();
  job.palette_size = static_cast<int64_t>(palette.shape(0));
  job.means = means.data();
  job.quats = quats.data();
  job.log_scales = log_scales.data();
  job.logit_opacities = logit_opacities.data();
  job.sh = sh.data();
  SogDamage found;
  {
    nb::gil_scoped_release released;
    found = decode_sog(job, threads);
  }
  return nb::make_tuple(found.tag, found.label);
}

void bind_find_codes(const In<float>& values, const In<float>& bounds, const Out<uint8_t>& codes, int threads) {
  nb::gil_scoped_release released;
  find_codes(values.data(), static_cast<int64_t>(values.size()), bounds.data(), codes.data(), threads);
}

}  // namespace

void bind_sog(nb::module_& m) {
  m.def("encode_sog", &bind_encode);
  m.def("decode_sog", &bind_decode);
  m.def("find_codes", &bind_find_codes);
}

}  // namespace splatree
