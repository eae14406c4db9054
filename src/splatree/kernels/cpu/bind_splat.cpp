#include <stdexcept>

#include "cpu/arrays.h"
#include "cpu/splat.h"

namespace splatree {

using namespace nb::literals;

namespace {

float* floats(const nb::object& gaussians, const char* name, int64_t num_rows, int64_t width, bool is_written) {
  const auto column = nb::cast<In<float>>(gaussians.attr(name));
  if (static_cast<int64_t>(column.shape(0)) != num_rows || static_cast<int64_t>(column.size()) != num_rows * width)
    throw std::invalid_argument("splat: columns differ in length");
  if (is_written) nb::cast<Out<float>>(gaussians.attr(name));  // throws if it is read-only
  return const_cast<float*>(column.data());
}

SplatColumns columns_of(const nb::object& gaussians, int64_t num_rows, bool is_written) {
  const auto sh = nb::cast<In<float>>(gaussians.attr("sh"));
  const int64_t stride = sh.ndim() == 3 ? static_cast<int64_t>(sh.shape(1) * sh.shape(2)) : 0;
  if (stride < 3) throw std::invalid_argument("splat: wanted harmonics \"n k 3\"");
  const auto column = [&](const char* name, int64_t width) { return floats(gaussians, name, num_rows, width, is_written); };
  return {column("means", 3), column("quats", 4), column("log_scales", 3), column("logit_opacities", 1), column("sh", stride), stride};
}

SplatRecords records_of(uint8_t* bytes, size_t num_bytes) {
  if (num_bytes % 32) throw std::invalid_argument("splat: wanted records of 32 bytes");
  return {bytes, static_cast<int64_t>(num_bytes / 32)};
}

void bind_encode(const nb::object& gaussians, const Out<uint8_t>& records, int threads) {
  const SplatRecords to = records_of(records.data(), records.size());
  const SplatColumns from = columns_of(gaussians, to.num_rows, false);
  nb::gil_scoped_release released;
  encode_splats(from, to, threads);
}

void bind_decode(const In<uint8_t>& records, const nb::object& gaussians, int threads) {
  const SplatRecords from = records_of(const_cast<uint8_t*>(records.data()), records.size());  // only read
  const SplatColumns to = columns_of(gaussians, from.num_rows, true);
  if (to.sh_stride != 3) throw std::invalid_argument("splat: wanted harmonics of degree 0");
  nb::gil_scoped_release released;
  decode_splats(from, to, threads);
}

void bind_rank(const nb::object& gaussians, const Out<uint16_t>& ranks, int threads) {
  const int64_t num_rows = static_cast<int64_t>(ranks.size());
  const SplatColumns from = columns_of(gaussians, num_rows, false);
  nb::gil_scoped_release released;
  rank_splats(from, num_rows, ranks.data(), threads);
}

}  // namespace

void bind_splat(nb::module_& m) {
  m.def("encode_splats", &bind_encode, "gaussians"_a, "records"_a, "threads"_a = 0);
  m.def("decode_splats", &bind_decode, "records"_a, "gaussians"_a, "threads"_a = 0);
  m.def("rank_splats", &bind_rank, "gaussians"_a, "ranks"_a, "threads"_a = 0);
}

}  // namespace splatree
