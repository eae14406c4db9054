#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/vector.h>

#include <cerrno>
#include <stdexcept>
#include <system_error>
#include <vector>

#include "cpu/columns.h"

namespace nb = nanobind;
using namespace nb::literals;

namespace splatree {
namespace {

using Bytes = nb::ndarray<const uint8_t, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using Longs = nb::ndarray<const int64_t, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using Matrix = nb::ndarray<float, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
using Values = nb::ndarray<const float, nb::ndim<1>, nb::c_contig, nb::device::cpu>;

using Quads = nb::ndarray<const float, nb::shape<-1, 4>, nb::c_contig, nb::device::cpu>;

constexpr int64_t kMaxRecordBytes = 1 << 20;  // a chunk of records is read at once
const int64_t kScalarBytes[] = {1, 1, 2, 2, 4, 4, 4, 8};

// `offsets` and `types` list the values of the first column, then of the second, and so on.
std::vector<float> bind_deinterleave(int file, int64_t start, int64_t stride, const Longs& offsets, const Bytes& types,
                       const std::vector<Matrix>& outputs, int threads) {
  const int64_t num_rows = outputs.empty() ? 0 : static_cast<int64_t>(outputs[0].shape(0));
  if (start < 0 || stride <= 0 || stride > kMaxRecordBytes)
    throw std::invalid_argument("deinterleave: no such place or size of a record");
  if (outputs.size() > kMaxColumns) throw std::invalid_argument("deinterleave: too many columns");
  if (offsets.size() != types.size()) throw std::invalid_argument("deinterleave: offsets and types differ in length");
  for (size_t i = 0; i < offsets.size(); ++i)
    if (types.data()[i] >= sizeof kScalarBytes / sizeof *kScalarBytes || offsets.data()[i] < 0 ||
        offsets.data()[i] + kScalarBytes[types.data()[i]] > stride)
      throw std::invalid_argument("deinterleave: a value lies outside of its record");

  std::vector<Column> columns;
  size_t first = 0;
  for (const Matrix& output : outputs) {
    if (static_cast<int64_t>(output.shape(0)) != num_rows || output.shape(1) == 0 || first + output.shape(1) > offsets.size())
      throw std::invalid_argument("deinterleave: columns differ in length, are empty or need more offsets");
    columns.push_back({output.data(), static_cast<int64_t>(output.shape(1)), offsets.data() + first,
                       reinterpret_cast<const Scalar*>(types.data()) + first, 0});
    first += output.shape(1);
  }
  try {
    nb::gil_scoped_release released;
    deinterleave(file, start, num_rows, stride, columns.data(), static_cast<int>(columns.size()), threads);
  } catch (const std::system_error& error) {
    errno = error.code().value();
    PyErr_SetFromErrno(PyExc_OSError);
    throw nb::python_error();
  }
  std::vector<float> magnitudes;
  for (const Column& column : columns) magnitudes.push_back(column.largest_magnitude);
  return magnitudes;
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
  m.def("deinterleave", &bind_deinterleave, "file"_a, "start"_a, "stride"_a, "offsets"_a, "types"_a, "outputs"_a, "threads"_a = 0);
  m.def("shortest", &bind_shortest, "vectors"_a, "threads"_a = 0);
  m.def("largest_magnitude", &bind_largest_magnitude, "values"_a, "threads"_a = 0);
}

}  // namespace splatree
