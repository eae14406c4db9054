// Glue of the selection and of its block index. Sizes are checked by the structs that arrive here; numbers are packed by
// kernels/cpu/frame/select.py.
#include <nanobind/stl/optional.h>
#include <nanobind/stl/pair.h>

#include <cstring>
#include <memory>
#include <optional>
#include <utility>
#include <vector>

#include "cpu/frame/ancestors.h"
#include "cpu/frame/select.h"
#include "cpu/frame/view.h"
#include "cpu/runtime/isa.h"
#include "cpu/runtime/pool.h"
#include "cpu/runtime/structs.h"

namespace splatree {
namespace {

using Vector32 = nb::ndarray<nb::numpy, int32_t, nb::ndim<1>>;

Vector32 to_numpy(int32_t* data, size_t size) {
  const nb::capsule owner(data, [](void* p) noexcept { delete[] static_cast<int32_t*>(p); });
  return Vector32(data, {size}, owner);
}

Vector32 copied(const std::vector<int32_t>& values) {
  int32_t* data = new int32_t[values.size()];
  if (!values.empty()) std::memcpy(data, values.data(), values.size() * sizeof(int32_t));
  return to_numpy(data, values.size());
}

SelectJob job_of(const py::Gaussians& gaussians, const py::GaussianTree& tree, const py::PackedQuestion& question) {
  SelectJob job{};
  job.means = column<float>(gaussians, "means");
  job.quats = column<float>(gaussians, "quats");
  job.log_scales = column<float>(gaussians, "log_scales");
  job.logit_opacities = column<float>(gaussians, "logit_opacities");
  job.extents = column<float>(tree, "extents");
  job.subtree_end = column<int32_t>(tree, "subtree_end");
  job.num_rows = int64_t(nb::len(tree));
  ask(question, job);
  return job;
}

BlockColumns blocks_of(const py::BlockIndex& blocks) {
  return {
      number<int>(blocks, "rows_per_block"),
      {column<float>(blocks, "lower"), column<float>(blocks, "upper"), column<float>(blocks, "leaf_scales")},
      {column<float>(blocks, "group_lower"), column<float>(blocks, "group_upper"), column<float>(blocks, "group_leaf_scales")},
      column<float>(blocks, "min_logits"),
      column<uint8_t>(blocks, "size_classes"),
      column<int32_t>(blocks, "ancestor_start"),
      column<int32_t>(blocks, "ancestors")};
}

std::pair<Vector32, int64_t> select_cut(py::Gaussians gaussians, py::GaussianTree tree, py::BlockIndex blocks,
                                        py::PackedQuestion question, py::PackedSides sides, std::optional<In<int32_t>> runs,
                                        int threads) {
  SelectJob job = job_of(gaussians, tree, question);
  job.index = blocks_of(blocks);
  job.runs = runs ? runs->data() : nullptr;
  job.num_runs = runs ? int64_t(runs->shape(0)) : 0;
  bound(sides, job);

  const int64_t rows_per_group = int64_t(job.index.rows_per_block) * BLOCKS_PER_GROUP;
  const int64_t num_groups = (job.num_rows + rows_per_group - 1) / rows_per_group;
  int32_t* rows;
  int64_t num_selected = 0, num_visited = 0;
  {
    nb::gil_scoped_release release;
    std::vector<std::vector<int32_t>> parts(num_groups);
    std::vector<int64_t> visited(num_groups);
    parallel_chunks(num_groups, threads, [&](int64_t group) {
      const std::unique_ptr<int32_t[]> space(new int32_t[rows_per_group + 16]);
      const RunResult found = kernels().select_group(job, group, space.get());
      parts[group].assign(space.get(), space.get() + found.num_selected);
      visited[group] = found.num_visited;
    });
    for (int64_t g = 0; g < num_groups; ++g) num_selected += int64_t(parts[g].size()), num_visited += visited[g];
    rows = new int32_t[num_selected];
    int32_t* place = rows;
    for (const std::vector<int32_t>& part : parts) {
      if (!part.empty()) std::memcpy(place, part.data(), part.size() * sizeof(int32_t));
      place += part.size();
    }
  }
  return {to_numpy(rows, size_t(num_selected)), num_visited};
}

Vector32 select_ancestors(py::Gaussians gaussians, py::GaussianTree tree, In<int32_t> ancestors, py::PackedQuestion question,
                          bool unseen_shadow, bool only_leaves_ask, int threads) {
  const SelectJob job = job_of(gaussians, tree, question);
  const AncestorTable table{ancestors.data(), int(ancestors.shape(1))};
  std::vector<int32_t> found;
  {
    nb::gil_scoped_release release;
    found = select_by_ancestors(job, table, {unseen_shadow, only_leaves_ask}, threads);
  }
  return copied(found);
}

// Answers for given rows, in chunks of fixed size.
template <class Ask>
void ask_rows(const SelectJob& job, const In<int32_t>& rows, Out<bool>& answers, int threads, const Ask& ask) {
  const int32_t* row = rows.data();
  uint8_t* answer = reinterpret_cast<uint8_t*>(answers.data());
  const int64_t count = int64_t(rows.shape(0));
  nb::gil_scoped_release release;
  parallel_ranges(count, 16 * MAX_BLOCK_ROWS, threads,
                  [&](int64_t begin, int64_t end) { ask(job, row + begin, end - begin, answer + begin); });
}

void small_of(py::Gaussians gaussians, py::GaussianTree tree, In<int32_t> rows, py::PackedQuestion question, Out<bool> answers,
              int threads) {
  ask_rows(job_of(gaussians, tree, question), rows, answers, threads, kernels().small_rows);
}

void visible_of(py::Gaussians gaussians, py::GaussianTree tree, In<int32_t> rows, py::PackedQuestion question, Out<bool> answers,
                int threads) {
  ask_rows(job_of(gaussians, tree, question), rows, answers, threads, kernels().visible_rows);
}

std::pair<Vector32, Vector32> block_ancestors(In<int32_t> subtree_end, int rows_per_block) {
  std::vector<int32_t> start{0}, ancestors;
  {
    struct Lists {
      std::vector<int32_t>*start, *ancestors;
    } lists{&start, &ancestors};
    nb::gil_scoped_release release;
    each_ancestors(
        subtree_end.data(), int64_t(subtree_end.shape(0)), rows_per_block,
        [](void* context, const int32_t* path, int64_t count) {
          Lists& to = *static_cast<Lists*>(context);
          to.ancestors->insert(to.ancestors->end(), path, path + count);
          to.start->push_back(int32_t(to.ancestors->size()));
        },
        &lists);
  }
  return {copied(start), copied(ancestors)};
}

void ancestor_table(In<uint8_t> depth, Out<int32_t> table) {
  nb::gil_scoped_release release;
  list_ancestors(depth.data(), int64_t(depth.shape(0)), int(table.shape(1)), table.data());
}

void block_bounds(py::Gaussians gaussians, py::GaussianTree tree, py::BlockIndex blocks, int threads) {
  const BoundsJob job{column<float>(gaussians, "means"),
                      column<float>(gaussians, "log_scales"),
                      column<float>(gaussians, "logit_opacities"),
                      column<int32_t>(tree, "subtree_end"),
                      column<float>(tree, "extents"),
                      int64_t(nb::len(tree)),
                      number<int>(blocks, "rows_per_block"),
                      threads,
                      out_column<float>(blocks, "lower"),
                      out_column<float>(blocks, "upper"),
                      out_column<float>(blocks, "leaf_scales"),
                      out_column<float>(blocks, "min_logits"),
                      out_column<float>(blocks, "group_lower"),
                      out_column<float>(blocks, "group_upper"),
                      out_column<float>(blocks, "group_leaf_scales"),
                      out_column<uint8_t>(blocks, "size_classes")};
  nb::gil_scoped_release release;
  bound_blocks(job);
}

}  // namespace

void bind_select(nb::module_& m) {
  m.attr("BLOCKS_PER_GROUP") = BLOCKS_PER_GROUP;
  m.attr("MAX_BLOCK_ROWS") = MAX_BLOCK_ROWS;
  m.def("select_cut", &select_cut, nb::arg("gaussians"), nb::arg("tree"), nb::arg("blocks"), nb::arg("question"),
        nb::arg("sides"), nb::arg("runs").none(), nb::arg("threads"),
        "Rows of the visible cut, ascending, and the number of rows visited.");
  m.def("select_ancestors", &select_ancestors, nb::arg("gaussians"), nb::arg("tree"), nb::arg("ancestors"), nb::arg("question"),
        nb::arg("unseen_shadow"), nb::arg("only_leaves_ask"), nb::arg("threads"),
        "Rows drawn by FilterGS's ancestor table, ascending.");
  m.def("ancestor_table", &ancestor_table, nb::arg("depth"), nb::arg("table"), "Fill the table of ancestors, parent first.");
  m.def("small_rows", &small_of, nb::arg("gaussians"), nb::arg("tree"), nb::arg("rows"), nb::arg("question"), nb::arg("answers"),
        nb::arg("threads"), "Whether each of the given rows is small.");
  m.def("visible_rows", &visible_of, nb::arg("gaussians"), nb::arg("tree"), nb::arg("rows"), nb::arg("question"),
        nb::arg("answers"), nb::arg("threads"), "Whether each of the given rows can be seen.");
  m.def("block_ancestors", &block_ancestors, nb::arg("subtree_end"), nb::arg("rows_per_block"),
        "Ancestors of the first row of each block, as starts and one list.");
  m.def("block_bounds", &block_bounds, nb::arg("gaussians"), nb::arg("tree"), nb::arg("blocks"), nb::arg("threads"),
        "Fill the bounds of blocks and groups.");
}

}  // namespace splatree
