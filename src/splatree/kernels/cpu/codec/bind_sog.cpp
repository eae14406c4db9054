// Glue of the pixels of SOG: arrays are made and checked in sog.py.
#include <nanobind/stl/optional.h>
#include <nanobind/stl/tuple.h>

#include <optional>
#include <tuple>

#include "cpu/codec/sog.h"
#include "cpu/runtime/structs.h"

namespace splatree {
namespace {

int64_t sh_stride_of(nb::handle gaussians) {
  const In<float> sh = nb::cast<In<float>>(gaussians.attr("sh"));
  return static_cast<int64_t>(sh.shape(1) * sh.shape(2));
}

// `pixels` are the pictures by name. Without a palette there are neither labels nor their picture.
void bind_encode(nb::handle gaussians, const In<int32_t>& places, const std::optional<In<int32_t>>& labels,
                 const In<double>& mean_ranges, const In<float>& scale_bounds, const In<float>& dc_bounds, const nb::dict& pixels,
                 int threads) {
  SogEncodeJob job{};
  job.num_rows = static_cast<int64_t>(places.shape(0));
  job.sh_stride = sh_stride_of(gaussians);
  job.means = column<float>(gaussians, "means");
  job.quats = column<float>(gaussians, "quats");
  job.log_scales = column<float>(gaussians, "log_scales");
  job.logit_opacities = column<float>(gaussians, "logit_opacities");
  job.sh = column<float>(gaussians, "sh");
  job.places = places.data();
  job.labels = labels ? labels->data() : nullptr;
  job.mean_ranges = mean_ranges.data();
  job.scale_bounds = scale_bounds.data();
  job.dc_bounds = dc_bounds.data();
  job.means_l = out_entry<uint8_t>(pixels, "means_l");
  job.means_u = out_entry<uint8_t>(pixels, "means_u");
  job.scales = out_entry<uint8_t>(pixels, "scales");
  job.quats_pixels = out_entry<uint8_t>(pixels, "quats");
  job.sh0 = out_entry<uint8_t>(pixels, "sh0");
  job.labels_pixels = out_entry<uint8_t>(pixels, "labels");
  nb::gil_scoped_release released;
  encode_sog(job, threads);
}

// `tables` are SogTables of Python.
std::tuple<int64_t, int64_t> bind_decode(const nb::dict& pixels, nb::handle tables, nb::handle out, int threads) {
  SogDecodeJob job{};
  job.num_rows = static_cast<int64_t>(nb::len(out));
  job.sh_stride = sh_stride_of(out);
  job.means_l = entry<uint8_t>(pixels, "means_l");
  job.means_u = entry<uint8_t>(pixels, "means_u");
  job.scales = entry<uint8_t>(pixels, "scales");
  job.labels = entry<uint8_t>(pixels, "labels");
  job.quats_pixels = entry<uint8_t>(pixels, "quats");
  job.sh0 = entry<uint8_t>(pixels, "sh0");
  job.mean_tables = column<float>(tables, "means");
  job.scale_tables = column<float>(tables, "log_scales");
  job.dc_tables = column<float>(tables, "dc");
  job.logit_table = column<float>(tables, "logits");
  job.rest_table = optional_column<float>(tables, "rest");
  job.palette = optional_column<uint8_t>(tables, "palette");
  job.palette_size = job.palette ? static_cast<int64_t>(nb::len(nb::object(tables.attr("palette")))) : 0;
  job.means = out_column<float>(out, "means");
  job.quats = out_column<float>(out, "quats");
  job.log_scales = out_column<float>(out, "log_scales");
  job.logit_opacities = out_column<float>(out, "logit_opacities");
  job.sh = out_column<float>(out, "sh");
  SogDamage found;
  {
    nb::gil_scoped_release released;
    found = decode_sog(job, threads);
  }
  return {found.tag, found.label};
}

void bind_find_codes(const In<float>& values, const In<float>& bounds, const Out<uint8_t>& codes, int threads) {
  nb::gil_scoped_release released;
  find_codes(values.data(), static_cast<int64_t>(values.size()), bounds.data(), codes.data(), threads);
}

}  // namespace

void bind_sog(nb::module_& m) {
  m.def("encode_sog", &bind_encode, nb::arg("gaussians"), nb::arg("places"), nb::arg("labels").none(), nb::arg("mean_ranges"),
        nb::arg("scale_bounds"), nb::arg("dc_bounds"), nb::arg("pixels"), nb::arg("threads"));
  m.def("decode_sog", &bind_decode, nb::arg("pixels"), nb::arg("tables"), nb::arg("out"), nb::arg("threads"));
  m.def("find_codes", &bind_find_codes, nb::arg("values"), nb::arg("bounds"), nb::arg("codes"), nb::arg("threads"));
}

}  // namespace splatree
