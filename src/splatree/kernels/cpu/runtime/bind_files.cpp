#include <nanobind/nanobind.h>

#include <cerrno>
#include <stdexcept>
#include <system_error>

#include "cpu/runtime/arrays.h"
#include "cpu/runtime/files.h"

namespace nb = nanobind;
using namespace nb::literals;

namespace splatree {
namespace {

void bind_reserve(int file, int64_t num_bytes) {
  if (num_bytes < 0) throw std::invalid_argument("reserve: wanted no less than 0 bytes");
  nb::gil_scoped_release released;
  reserve(file, num_bytes);
}

}  // namespace

void bind_files(nb::module_& m) {
  // What the system refuses is an OSError, whichever function met it.
  nb::register_exception_translator([](const std::exception_ptr& thrown, void*) {
    try {
      std::rethrow_exception(thrown);
    } catch (const std::system_error& error) {
#ifdef _WIN32
      if (error.code().category() == std::system_category()) {
        PyErr_SetFromWindowsErr(error.code().value());
        return;
      }
#endif
      errno = error.code().value();
      PyErr_SetFromErrno(PyExc_OSError);
    }
  });
  m.def(
      "write_at",
      [](int file, In<uint8_t> data, int64_t at) {
        nb::gil_scoped_release released;
        write_at(file, data.data(), int64_t(data.size()), at);
      },
      "file"_a, "data"_a, "at"_a);
  m.def("reserve", &bind_reserve, "file"_a, "num_bytes"_a);
}

}  // namespace splatree
