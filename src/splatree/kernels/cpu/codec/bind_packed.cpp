#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <stdexcept>

#include "cpu/codec/packed.h"
#include "cpu/runtime/arrays.h"
#include "cpu/runtime/isa.h"
#include "cpu/runtime/pool.h"

using namespace nanobind::literals;

namespace splatree {
namespace {

float* writable(const In<float>& values) { return const_cast<float*>(values.data()); }

void bind_pack(const In<float>& means, const In<float>& quats, const In<float>& log_scales, const In<float>& logits,
               const In<float>& sh, const In<int64_t>& order, const Out<float>& bounds, const Out<uint32_t>& vertices,
               const Out<uint8_t>& rest, int threads) {
  const int64_t num_scene = means.shape(0), num_rows = order.shape(0);
  for (int64_t i = 0; i < num_rows; ++i)
    if (order.data()[i] < 0 || order.data()[i] >= num_scene) throw std::invalid_argument("pack: no such row");
  const PackedJob job{writable(means), writable(quats), writable(log_scales),          writable(logits), writable(sh),
                      order.data(),    num_rows,        static_cast<int>(sh.shape(1)), bounds.data(),    vertices.data(),
                      rest.data(),     nullptr};
  nb::gil_scoped_release released;
  parallel_chunks((num_rows + PACKED_CHUNK - 1) / PACKED_CHUNK, threads,
                  [&](int64_t chunk) { kernels().pack_chunk(job, chunk); });
}

void bind_unpack(const In<float>& bounds, const In<uint32_t>& vertices, const In<uint8_t>& rest, const In<float>& logit_table,
                 const Out<float>& means, const Out<float>& quats, const Out<float>& log_scales, const Out<float>& logits,
                 const Out<float>& sh, int threads) {
  const int64_t num_rows = means.shape(0);
  const PackedJob job{means.data(),
                      quats.data(),
                      log_scales.data(),
                      logits.data(),
                      sh.data(),
                      nullptr,
                      num_rows,
                      static_cast<int>(sh.shape(1)),
                      const_cast<float*>(bounds.data()),
                      const_cast<uint32_t*>(vertices.data()),
                      const_cast<uint8_t*>(rest.data()),
                      logit_table.data()};
  nb::gil_scoped_release released;
  parallel_chunks((num_rows + PACKED_CHUNK - 1) / PACKED_CHUNK, threads,
                  [&](int64_t chunk) { kernels().unpack_chunk(job, chunk); });
}

}  // namespace

void bind_packed(nb::module_& m) {
  m.def("pack_chunks", &bind_pack, "means"_a, "quats"_a, "log_scales"_a, "logits"_a, "sh"_a, "order"_a, "bounds"_a, "vertices"_a,
        "rest"_a, "threads"_a);
  m.def("unpack_chunks", &bind_unpack, "bounds"_a, "vertices"_a, "rest"_a, "logit_table"_a, "means"_a, "quats"_a, "log_scales"_a,
        "logits"_a, "sh"_a, "threads"_a);
}

}  // namespace splatree
