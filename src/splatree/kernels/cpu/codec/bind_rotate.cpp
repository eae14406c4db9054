#include <stdexcept>

#include "cpu/codec/rotate.h"
#include "cpu/runtime/arrays.h"

namespace splatree {

using namespace nb::literals;

namespace {

void bind_rotate_harmonics(const In<float>& sh, const In<float>& matrices, const Out<float>& out, int threads) {
  const size_t k = sh.ndim() == 3 ? sh.shape(1) : 0;
  int degree = 0;
  size_t entries = 0;
  while (degree < 3 && size_t(degree + 1) * (degree + 1) < k) {
    ++degree;
    entries += size_t(2 * degree + 1) * (2 * degree + 1);
  }
  if (k != size_t(degree + 1) * (degree + 1) || sh.shape(2) != 3 || out.size() != sh.size() || matrices.size() != entries)
    throw std::invalid_argument("rotate_harmonics: wanted harmonics \"n k 3\", as many out, and a matrix for each degree");
  nb::gil_scoped_release released;
  rotate_harmonics(sh.data(), static_cast<int64_t>(sh.shape(0)), degree, matrices.data(), out.data(), threads);
}

}  // namespace

void bind_rotate(nb::module_& m) {
  m.def("rotate_harmonics", &bind_rotate_harmonics, "sh"_a, "matrices"_a, "out"_a, "threads"_a = 0);
}

}  // namespace splatree
