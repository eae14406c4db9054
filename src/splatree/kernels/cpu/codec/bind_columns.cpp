#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/vector.h>

#include <stdexcept>
#include <vector>

#include "cpu/codec/columns.h"

namespace nb = nanobind;
using namespace nb::literals;

namespace splatree {
namespace {

using Bytes = nb::ndarray<const uint8_t, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using Longs = nb::ndarray<const int64_t, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using Matrix = nb::ndarray<float, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
using ConstMatrix = nb::ndarray<const float, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
using Records = nb::ndarray<uint8_t, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using Values = nb::ndarray<const float, nb::ndim<1>, nb::c_contig, nb::device::cpu>;

using Quads = nb::ndarray<const float, nb::shape<-1, 4>, nb::c_contig, nb::device::cpu>;

constexpr int64_t MAX_RECORD_BYTES = 1 << 20;  // a chunk of records is read at once
const int64_t SCALAR_BYTES[] = {1, 1, 2, 2, 4, 4, 4, 8};

// `offsets` and `types` list the values of the first column, then of the second, and so on.
template <class Matrices>
std::vector<Column> columns_of(int64_t stride, const Longs& offsets, const Bytes& types, const Matrices& matrices) {
  const int64_t num_rows = matrices.empty() ? 0 : static_cast<int64_t>(matrices[0].shape(0));
  if (stride <= 0 || stride > MAX_RECORD_BYTES) throw std::invalid_argument("columns: no such size of a record");
  if (matrices.size() > MAX_COLUMNS) throw std::invalid_argument("columns: too many columns");
  if (offsets.size() != types.size()) throw std::invalid_argument("columns: offsets and types differ in length");
  for (size_t i = 0; i < offsets.size(); ++i)
    if (types.data()[i] >= sizeof SCALAR_BYTES / sizeof *SCALAR_BYTES || offsets.data()[i] < 0 ||
        offsets.data()[i] + SCALAR_BYTES[types.data()[i]] > stride)
      throw std::invalid_argument("columns: a value lies outside of its record");

  std::vector<Column> columns;
  size_t first = 0;
  for (const auto& matrix : matrices) {
    if (static_cast<int64_t>(matrix.shape(0)) != num_rows || matrix.shape(1) == 0 || first + matrix.shape(1) > offsets.size())
      throw std::invalid_argument("columns: they differ in length, are empty or need more offsets");
    columns.push_back({const_cast<float*>(matrix.data()), static_cast<int64_t>(matrix.shape(1)), offsets.data() + first,
                       reinterpret_cast<const Scalar*>(types.data()) + first, 0});  // interleave() only reads
    first += matrix.shape(1);
  }
  return columns;
}

std::vector<float> bind_deinterleave(int file, int64_t start, int64_t stride, const Longs& offsets, const Bytes& types,
                                     const std::vector<Matrix>& outputs, int threads) {
  if (start < 0) throw std::invalid_argument("deinterleave: no such place");
  std::vector<Column> columns = columns_of(stride, offsets, types, outputs);
  const int64_t num_rows = outputs.empty() ? 0 : static_cast<int64_t>(outputs[0].shape(0));
  {
    nb::gil_scoped_release released;
    deinterleave(file, start, num_rows, stride, columns.data(), static_cast<int>(columns.size()), threads);
  }
  std::vector<float> magnitudes;
  for (const Column& column : columns) magnitudes.push_back(column.largest_magnitude);
  return magnitudes;
}

void bind_interleave(int64_t stride, const Longs& offsets, const Bytes& types, const std::vector<ConstMatrix>& inputs,
                     const Records& records, int threads) {
  const std::vector<Column> columns = columns_of(stride, offsets, types, inputs);
  const int64_t num_rows = inputs.empty() ? 0 : static_cast<int64_t>(inputs[0].shape(0));
  for (size_t i = 0; i < types.size(); ++i)
    if (types.data()[i] != static_cast<uint8_t>(Scalar::f32)) throw std::invalid_argument("interleave: wanted floats");
  if (static_cast<int64_t>(records.size()) < num_rows * stride) throw std::invalid_argument("interleave: too few records");
  nb::gil_scoped_release released;
  interleave(columns.data(), static_cast<int>(columns.size()), num_rows, stride, records.data(), threads);
}

float bind_largest_magnitude(const Values& values, int threads) {
  nb::gil_scoped_release released;
  return largest_magnitude(values.data(), static_cast<int64_t>(values.size()), threads);
}

float bind_shortest(const Quads& vectors, int threads) {
  nb::gil_scoped_release released;
  return shortest(vectors.data(), static_cast<int64_t>(vectors.shape(0)), threads);
}

}  // namespace

void bind_columns(nb::module_& m) {
  m.def("deinterleave", &bind_deinterleave, "file"_a, "start"_a, "stride"_a, "offsets"_a, "types"_a, "outputs"_a,
        "threads"_a = 0);
  m.def("interleave", &bind_interleave, "stride"_a, "offsets"_a, "types"_a, "inputs"_a, "records"_a, "threads"_a = 0);
  m.def("shortest", &bind_shortest, "vectors"_a, "threads"_a = 0);
  m.def("largest_magnitude", &bind_largest_magnitude, "values"_a, "threads"_a = 0);
}

}  // namespace splatree
