// Arrays as the glue of the stages takes them: contiguous, on the processor; sizes are checked by the callers in
// kernels/cpu/*.py.
#pragma once
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

namespace splatree {

namespace nb = nanobind;

template <class T>
using In = nb::ndarray<const T, nb::c_contig, nb::device::cpu>;
template <class T>
using Out = nb::ndarray<T, nb::c_contig, nb::device::cpu>;

}  // namespace splatree
