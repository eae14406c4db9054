#include <atomic>
#include <cstring>
#include <stdexcept>

#include "cpu/codec/splat.h"
#include "cpu/runtime/arrays.h"
#include "cpu/runtime/isa.h"
#include "cpu/runtime/pool.h"

namespace splatree {

using namespace nb::literals;

namespace {

constexpr int64_t ROWS_PER_CHUNK = 4096;

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
  return {column("means", 3),           column("quats", 4),   column("log_scales", 3),
          column("logit_opacities", 1), column("sh", stride), stride};
}

int64_t records_in(size_t num_bytes) {
  if (num_bytes % SPLAT_BYTES) throw std::invalid_argument("splat: wanted records of 32 bytes");
  return static_cast<int64_t>(num_bytes) / SPLAT_BYTES;
}

float bind_encode(const nb::object& gaussians, const Out<uint8_t>& records, int threads) {
  const int64_t num_rows = records_in(records.size());
  const SplatColumns from = columns_of(gaussians, num_rows, false);
  std::atomic<int32_t> largest{0};
  {
    nb::gil_scoped_release released;
    parallel_ranges(num_rows, ROWS_PER_CHUNK, threads, [&](int64_t begin, int64_t end) {
      const int32_t found = kernels().encode_splats(from, begin, end, records.data());
      int32_t seen = largest.load();
      while (found > seen && !largest.compare_exchange_weak(seen, found)) {
      }
    });
  }
  const int32_t bits = largest.load();
  float magnitude;
  std::memcpy(&magnitude, &bits, sizeof magnitude);
  return magnitude;
}

void bind_decode(const In<uint8_t>& records, const nb::object& gaussians, int threads) {
  const int64_t num_rows = records_in(records.size());
  const SplatColumns to = columns_of(gaussians, num_rows, true);
  if (to.sh_stride != 3) throw std::invalid_argument("splat: wanted harmonics of degree 0");
  static const SplatTables tables = splat_tables();
  nb::gil_scoped_release released;
  parallel_ranges(num_rows, ROWS_PER_CHUNK, threads,
                  [&](int64_t begin, int64_t end) { kernels().decode_splats(records.data(), tables, to, begin, end); });
}

void bind_rank(const nb::object& gaussians, const Out<uint16_t>& ranks, int threads) {
  const int64_t num_rows = static_cast<int64_t>(ranks.size());
  const SplatColumns from = columns_of(gaussians, num_rows, false);
  nb::gil_scoped_release released;
  parallel_ranges(num_rows, ROWS_PER_CHUNK, threads,
                  [&](int64_t begin, int64_t end) { kernels().rank_splats(from, begin, end, ranks.data()); });
}

void bind_place(const In<uint8_t>& records, const In<uint16_t>& ranks, const Out<int64_t>& places, int file) {
  const int64_t num_rows = records_in(records.size());
  if (static_cast<int64_t>(ranks.size()) != num_rows || places.size() != SPLAT_RANKS)
    throw std::invalid_argument("splat: wanted a rank for each record and a place for each rank");
  nb::gil_scoped_release released;
  for (int64_t row = 0; row < num_rows; ++row)
    if (ranks.data()[row] >= SPLAT_RANKS) throw std::invalid_argument("splat: no such rank");
  place_splats(records.data(), ranks.data(), num_rows, places.data(), file);
}

}  // namespace

void bind_splat(nb::module_& m) {
  m.def("encode_splats", &bind_encode, "gaussians"_a, "records"_a, "threads"_a = 0);
  m.def("decode_splats", &bind_decode, "records"_a, "gaussians"_a, "threads"_a = 0);
  m.def("rank_splats", &bind_rank, "gaussians"_a, "ranks"_a, "threads"_a = 0);
  m.def("place_splats", &bind_place, "records"_a, "ranks"_a, "places"_a, "file"_a);
}

}  // namespace splatree
