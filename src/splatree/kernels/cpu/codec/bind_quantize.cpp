#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <stdexcept>

#include "cpu/codec/quantize.h"
#include "cpu/runtime/arrays.h"
#include "cpu/runtime/isa.h"
#include "cpu/runtime/pool.h"

using namespace nanobind::literals;

namespace splatree {
namespace {

constexpr int64_t ROWS_PER_CHUNK = 1 << 12;  // 4096 rows of 180 bytes stay in a second-level cache

ByteColumn column_of(float* values, int64_t stride, int64_t skip, uint8_t* codes, int64_t width, const In<float>& scale,
                     const In<float>& offset, const int32_t* step) {
  if (width > MAX_WIDTH || skip < 0 || skip + width > stride || int64_t(scale.size()) != width || int64_t(offset.size()) != width)
    throw std::invalid_argument("quantize: the columns do not fit together");
  if (width != 3 && width != 9 && width != 24 && width != 45)
    throw std::invalid_argument("quantize: wanted 3, 9, 24 or 45 values a row");
  ByteColumn column{values + skip, codes, stride, static_cast<int>(width), {}, {}, {}};
  for (int64_t j = 0; j < width; ++j) {
    column.scale[j] = scale.data()[j];
    column.offset[j] = offset.data()[j];
    column.step[j] = step ? step[j] : 1;
  }
  return column;
}

void bind_to_bytes(const In<float>& values, int64_t skip, const In<float>& scale, const In<float>& offset,
                   const In<int32_t>& step, const Out<uint8_t>& codes, int threads) {
  if (int64_t(step.size()) != int64_t(codes.shape(1))) throw std::invalid_argument("quantize: wanted a step for each value");
  const ByteColumn column = column_of(const_cast<float*>(values.data()), values.shape(1), skip, codes.data(), codes.shape(1),
                                      scale, offset, step.data());
  const int64_t num_rows = values.shape(0);
  nb::gil_scoped_release released;
  parallel_ranges(num_rows, ROWS_PER_CHUNK, threads, [&](int64_t begin, int64_t end) { kernels().quantize(column, begin, end); });
}

void bind_from_bytes(const In<uint8_t>& codes, const In<float>& scale, const In<float>& offset, const Out<float>& values,
                     int64_t skip, int threads) {
  const ByteColumn column =
      column_of(values.data(), values.shape(1), skip, const_cast<uint8_t*>(codes.data()), codes.shape(1), scale, offset, nullptr);
  const int64_t num_rows = values.shape(0);
  nb::gil_scoped_release released;
  parallel_ranges(num_rows, ROWS_PER_CHUNK, threads,
                  [&](int64_t begin, int64_t end) { kernels().dequantize(column, begin, end); });
}

void bind_bytes_from_logits(const In<float>& logits, const Out<uint8_t>& codes, int threads) {
  const int64_t num_rows = logits.shape(0);
  nb::gil_scoped_release released;
  parallel_ranges(num_rows, 4 * ROWS_PER_CHUNK, threads,
                  [&](int64_t begin, int64_t end) { kernels().bytes_from_logits(logits.data(), begin, end, codes.data()); });
}

Triples triples_of(const float* values, const uint8_t* codes, const In<float>& signs, float scale) {
  Triples job{const_cast<float*>(values), const_cast<uint8_t*>(codes), {1, 1, 1, 1}, scale};
  for (size_t j = 0; j < signs.size() && j < 4; ++j) job.signs[j] = signs.data()[j];
  return job;
}

void bind_fixed_from_means(const In<float>& means, const In<float>& signs, float scale, const Out<uint8_t>& codes, int threads) {
  const Triples job = triples_of(means.data(), codes.data(), signs, scale);
  const int64_t num_rows = means.shape(0);
  nb::gil_scoped_release released;
  parallel_ranges(num_rows, ROWS_PER_CHUNK, threads, [&](int64_t begin, int64_t end) { kernels().pack_fixed(job, begin, end); });
}

void bind_means_from_fixed(const In<uint8_t>& codes, float scale, const Out<float>& means, int threads) {
  const Triples job{means.data(), const_cast<uint8_t*>(codes.data()), {}, scale};
  const int64_t num_rows = means.shape(0);
  nb::gil_scoped_release released;
  parallel_ranges(num_rows, ROWS_PER_CHUNK, threads,
                  [&](int64_t begin, int64_t end) { kernels().unpack_fixed(job, begin, end); });
}

QuatCode kind_of(int64_t width) {
  if (width != 3 && width != 4) throw std::invalid_argument("quats: wanted codes of 3 or 4 bytes");
  return width == 4 ? QuatCode::smallest_three : QuatCode::first_three;
}

void bind_codes_from_quats(const In<float>& quats, const In<float>& signs, const Out<uint8_t>& codes, int threads) {
  const Triples job = triples_of(quats.data(), codes.data(), signs, 1);
  const QuatCode kind = kind_of(codes.shape(1));
  const int64_t num_rows = quats.shape(0);
  nb::gil_scoped_release released;
  parallel_ranges(num_rows, ROWS_PER_CHUNK, threads,
                  [&](int64_t begin, int64_t end) { kernels().pack_quats(job, kind, begin, end); });
}

void bind_quats_from_codes(const In<uint8_t>& codes, const Out<float>& quats, int threads) {
  const Triples job{quats.data(), const_cast<uint8_t*>(codes.data()), {}, 1};
  const QuatCode kind = kind_of(codes.shape(1));
  const int64_t num_rows = quats.shape(0);
  nb::gil_scoped_release released;
  parallel_ranges(num_rows, ROWS_PER_CHUNK, threads,
                  [&](int64_t begin, int64_t end) { kernels().unpack_quats(job, kind, begin, end); });
}

}  // namespace

void bind_quantize(nb::module_& m) {
  m.def("bytes_from_values", &bind_to_bytes, "values"_a, "skip"_a, "scale"_a, "offset"_a, "step"_a, "codes"_a, "threads"_a);
  m.def("values_from_bytes", &bind_from_bytes, "codes"_a, "scale"_a, "offset"_a, "values"_a, "skip"_a, "threads"_a);
  m.def("bytes_from_logits", &bind_bytes_from_logits, "logits"_a, "codes"_a, "threads"_a);
  m.def("fixed_from_means", &bind_fixed_from_means, "means"_a, "signs"_a, "scale"_a, "codes"_a, "threads"_a);
  m.def("means_from_fixed", &bind_means_from_fixed, "codes"_a, "scale"_a, "means"_a, "threads"_a);
  m.def("codes_from_quats", &bind_codes_from_quats, "quats"_a, "signs"_a, "codes"_a, "threads"_a);
  m.def("quats_from_codes", &bind_quats_from_codes, "codes"_a, "quats"_a, "threads"_a);
}

}  // namespace splatree
