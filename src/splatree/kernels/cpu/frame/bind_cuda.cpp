// The numbers of a frame as kernels on a GPU take them, laid out here, where the compiler knows the structs; and arrays in the
// memory of a GPU as other libraries give and take them (DLPack).
#include <nanobind/stl/array.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include <array>
#include <cmath>
#include <optional>
#include <string>
#include <tuple>
#include <vector>

#include "cpu/frame/view.h"
#include "cuda/job.h"
#include "shared/constants.h"

namespace splatree {
namespace {

nb::bytes frame_numbers(py::PackedQuestion question, py::PackedSides sides, py::View view, int degree,
                        std::optional<py::SquareRule> square, bool whole_box) {
  FrameNumbers n{};
  ask(question, n);
  bound(sides, n);
  n.view.antialiased = number<std::string>(view, "mode") == "antialiased";
  n.view.least_opacity = number_of(view, "least_opacity");
  n.degree = degree;
  const nb::object camera = view.attr("camera");
  n.width = number<int>(camera, "width"), n.height = number<int>(camera, "height");
  n.num_tiles_x = (n.width + constants::TILE_PX - 1) / constants::TILE_PX;
  n.num_tiles_y = (n.height + constants::TILE_PX - 1) / constants::TILE_PX;
  const auto background = number<std::array<double, 3>>(view, "background");
  for (int i = 0; i < 3; ++i) n.background[i] = float(background[i]);
  n.log2_threshold = float(std::log2(number<double>(view, "threshold"))), n.area_power = number_of(view, "area_power");
  n.log2_pixel_threshold = float(std::log2(number<double>(view, "pixel_threshold")));
  n.tile_rule = int(square ? TileRule::SQUARE : whole_box ? TileRule::BOX : TileRule::ELLIPSE);
  if (square) n.square = square_of(*square);
  return nb::bytes(reinterpret_cast<const char*>(&n), sizeof n);
}

// The capsule that consumers of DLPack take, which keeps `owner`.
nb::object export_tensor(uint64_t pointer, const std::vector<size_t>& shape, const std::string& type,
                         const std::tuple<int, int>& device, nb::object owner) {
  const uint8_t bits = uint8_t(8 * std::stoi(type.substr(2)));
  const nb::dlpack::dtype_code code = type[1] == 'f'   ? nb::dlpack::dtype_code::Float
                                      : type[1] == 'i' ? nb::dlpack::dtype_code::Int
                                                       : nb::dlpack::dtype_code::UInt;
  const nb::ndarray<> tensor(reinterpret_cast<void*>(pointer), shape.size(), shape.data(), owner, nullptr,
                             nb::dlpack::dtype{uint8_t(code), bits, 1}, std::get<0>(device), std::get<1>(device));
  return nb::cast(tensor);
}

// Address, shape, whether it is contiguous, type, ordinal of the GPU (-1: not in one's memory), and what keeps it, of a capsule.
using Tensor = std::tuple<uint64_t, std::vector<size_t>, bool, std::string, int, nb::object>;
Tensor import_tensor(nb::ndarray<nb::ro> tensor) {
  std::vector<size_t> shape;
  bool contiguous = true;
  int64_t step = 1;
  for (size_t i = tensor.ndim(); i-- > 0;) {
    shape.insert(shape.begin(), tensor.shape(i));
    contiguous &= tensor.shape(i) == 1 || tensor.stride(i) == step;
    step *= int64_t(tensor.shape(i));
  }
  const nb::dlpack::dtype type = tensor.dtype();
  const char* const names[] = {"int", "uint", "float", "opaque", "bfloat", "complex", "bool"};
  const std::string name = (type.code < 7 ? names[type.code] : "code") + std::to_string(type.bits);
  const bool on_gpu = tensor.device_type() == nb::device::cuda::value;
  return {reinterpret_cast<uint64_t>(tensor.data()), shape, contiguous, name, on_gpu ? tensor.device_id() : -1,
          nb::cast(tensor, nb::rv_policy::reference)};
}

}  // namespace

void bind_cuda(nb::module_& m) {
  m.def("frame_numbers", &frame_numbers, nb::arg("question"), nb::arg("sides"), nb::arg("view"), nb::arg("degree"),
        nb::arg("square").none(), nb::arg("whole_box"), "The struct FrameNumbers of kernels/cuda/job.h as bytes.");
  m.def("export_tensor", &export_tensor, nb::arg("pointer"), nb::arg("shape"), nb::arg("type"), nb::arg("device"),
        nb::arg("owner"), "A DLPack capsule of an array at an address; the device as DLPack has it.");
  m.def("import_tensor", &import_tensor, nb::arg("capsule"),
        "Address, shape, whether contiguous, type, ordinal of the GPU or -1, and the keeper of a DLPack capsule.");
}

}  // namespace splatree
