// The extension module: each stage's glue file adds its functions.
#include <nanobind/nanobind.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include <string>
#include <vector>

#include "cpu/runtime/isa.h"
#include "cpu/runtime/pool.h"
#include "cpu/runtime/processors.h"

namespace nb = nanobind;
using namespace splatree;

namespace splatree {
void bind_render(nb::module_& m);
void bind_paging(nb::module_& m);
void bind_palette(nb::module_& m);
void bind_sog(nb::module_& m);
void bind_files(nb::module_& m);
void bind_columns(nb::module_& m);
void bind_thin(nb::module_& m);
void bind_select(nb::module_& m);
void bind_clusters(nb::module_& m);
void bind_cull(nb::module_& m);
void bind_machine(nb::module_& m);
void bind_rotate(nb::module_& m);
void bind_quantize(nb::module_& m);
void bind_baselines(nb::module_& m);
void bind_partners(nb::module_& m);
void bind_splat(nb::module_& m);
void bind_cuda(nb::module_& m);
void bind_packed(nb::module_& m);
void bind_nodes(nb::module_& m);
void bind_train(nb::module_& m);
}  // namespace splatree

NB_MODULE(_core, m) {
  m.doc() = "Native kernels of splatree; use them through splatree.kernels.cpu.";

  m.def("hardware_threads", &hardware_threads, "Processors this process may use.");
  m.def("quota_processors", &quota_processors, nb::arg("membership"), nb::arg("mount"),
        "Processors' worth of time that control groups grant, as these files say; 0 if there is no limit.");
  m.def("isa", [] { return kernels().isa; }, "Instruction-set level in use.");
  m.def(
      "isas",
      [] {
        std::vector<std::string> names;
        each_isa([](void* c, const char* n) { static_cast<std::vector<std::string>*>(c)->push_back(n); }, &names);
        return names;
      },
      "Levels that this build has and this processor runs, best first.");
  m.def(
      "use_isa",
      [](const std::string& name) {
        if (!use_isa(name.c_str())) throw nb::value_error(("this processor or build lacks level " + name).c_str());
      },
      nb::arg("name"), "Switch to another level; for tests, not while kernels run.");

  m.def(
      "run_chunks",
      [](int64_t num_chunks, int threads, const nb::callable& function) {
        nb::gil_scoped_release release;
        parallel_chunks(num_chunks, threads, [&](int64_t chunk) {
          nb::gil_scoped_acquire acquire;
          function(chunk);
        });
      },
      nb::arg("num_chunks"), nb::arg("threads"), nb::arg("function"),
      "Call a function for each chunk on the threads of the pool; for tests of the pool.");

  bind_render(m);
  bind_paging(m);
  bind_palette(m);
  bind_sog(m);
  bind_files(m);
  bind_columns(m);
  bind_thin(m);
  bind_select(m);
  bind_clusters(m);
  bind_cull(m);
  bind_machine(m);
  bind_rotate(m);
  bind_quantize(m);
  bind_baselines(m);
  bind_partners(m);
  bind_splat(m);
  bind_cuda(m);
  bind_packed(m);
  bind_nodes(m);
  bind_train(m);
}
