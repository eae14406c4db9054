// Glue of the selection and of its block index. Sizes are checked by the structs that arrive here; numbers are packed by
// kernels/cpu/frame/select.py.
#include <nanobind/stl/optional.h>
#include <nanobind/stl/pair.h>
#include <nanobind/stl/tuple.h>

#include <algorithm>
#include <cstring>
#include <memory>
#include <optional>
#include <tuple>
#include <type_traits>
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

template <class T>
using Made = nb::ndarray<nb::numpy, T, nb::ndim<1>>;
using Vector32 = Made<int32_t>;

template <class T>
Made<T> to_numpy(T* data, size_t size) {
  const nb::capsule owner(data, [](void* p) noexcept { delete[] static_cast<T*>(p); });
  return Made<T>(data, {size}, owner);
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
  return {number<int>(blocks, "rows_per_block"),
          {column<float>(blocks, "lower"), column<float>(blocks, "upper"), column<float>(blocks, "leaf_scales"),
           column<float>(blocks, "step_extents"), column<float>(blocks, "step_scales")},
          {column<float>(blocks, "group_lower"), column<float>(blocks, "group_upper"), column<float>(blocks, "group_leaf_scales"),
           nullptr, nullptr},
          column<float>(blocks, "min_logits"),
          column<uint8_t>(blocks, "size_classes"),
          column<int32_t>(blocks, "ancestor_start"),
          column<int32_t>(blocks, "ancestors")};
}

SelectJob cut_job(const py::Gaussians& gaussians, const py::GaussianTree& tree, const py::BlockIndex& blocks,
                  const py::PackedQuestion& question, const py::PackedSides& sides, const std::optional<In<int32_t>>& runs) {
  SelectJob job = job_of(gaussians, tree, question);
  job.index = blocks_of(blocks);
  job.runs = runs ? runs->data() : nullptr;
  job.num_runs = runs ? int64_t(runs->shape(0)) : 0;
  job.fine_limit = job.rule.limit;
  job.every = 1;
  bound(sides, job);
  return job;
}

// Rows, and of a range also their limits.
struct Found {
  CutRows rows;
  int64_t num_selected, num_visited;
};

// What the groups of a job find, one behind the other.
Found select_groups(const SelectJob& job, bool is_range, int threads) {
  struct Part {
    std::vector<int32_t> rows;
    std::vector<float> enters, leaves;
    int64_t num_visited;
  };
  const int64_t rows_per_group = int64_t(job.index.rows_per_block) * BLOCKS_PER_GROUP;
  const int64_t num_groups = (job.num_rows + rows_per_group - 1) / rows_per_group;
  std::vector<Part> parts(num_groups);
  parallel_chunks(num_groups, threads, [&](int64_t group) {
    const int64_t room = rows_per_group + 16;
    const std::unique_ptr<int32_t[]> rows(new int32_t[room]);
    const std::unique_ptr<float[]> limits(is_range ? new float[2 * room] : nullptr);
    float* leaves = is_range ? limits.get() + room : nullptr;
    const RunResult found = kernels().select_group(job, group, {rows.get(), limits.get(), leaves});
    Part& part = parts[group];
    part.rows.assign(rows.get(), rows.get() + found.num_selected);
    if (is_range) {
      part.enters.assign(limits.get(), limits.get() + found.num_selected);
      part.leaves.assign(leaves, leaves + found.num_selected);
    }
    part.num_visited = found.num_visited;
  });
  Found all{};
  for (const Part& part : parts) all.num_selected += int64_t(part.rows.size()), all.num_visited += part.num_visited;
  const auto joined = [&](auto member) {
    using T = typename std::decay_t<decltype(parts[0].*member)>::value_type;
    T* const values = new T[all.num_selected];
    T* place = values;
    for (const Part& part : parts) place = std::copy((part.*member).begin(), (part.*member).end(), place);
    return values;
  };
  all.rows.rows = joined(&Part::rows);
  if (is_range) all.rows.enters = joined(&Part::enters), all.rows.leaves = joined(&Part::leaves);
  return all;
}

std::pair<Vector32, int64_t> select_cut(py::Gaussians gaussians, py::GaussianTree tree, py::BlockIndex blocks,
                                        py::PackedQuestion question, py::PackedSides sides, std::optional<In<int32_t>> runs,
                                        int threads) {
  const SelectJob job = cut_job(gaussians, tree, blocks, question, sides, runs);
  Found found;
  {
    nb::gil_scoped_release release;
    found = select_groups(job, false, threads);
  }
  return {to_numpy(found.rows.rows, size_t(found.num_selected)), found.num_visited};
}

std::tuple<Vector32, Made<float>, Made<float>, int64_t> select_range(py::Gaussians gaussians, py::GaussianTree tree,
                                                                     py::BlockIndex blocks, py::PackedQuestion question,
                                                                     py::PackedSides sides, std::optional<In<int32_t>> runs,
                                                                     float fine_limit, int64_t every, int threads) {
  SelectJob job = cut_job(gaussians, tree, blocks, question, sides, runs);
  job.fine_limit = fine_limit;
  job.every = every;
  Found found;
  {
    nb::gil_scoped_release release;
    found = select_groups(job, true, threads);
  }
  const size_t size = size_t(found.num_selected);
  return {to_numpy(found.rows.rows, size), to_numpy(found.rows.enters, size), to_numpy(found.rows.leaves, size),
          found.num_visited};
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
                      out_column<float>(blocks, "step_extents"),
                      out_column<float>(blocks, "step_scales"),
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
  m.def(
      "select_range", &select_range, nb::arg("gaussians"), nb::arg("tree"), nb::arg("blocks"), nb::arg("question"),
      nb::arg("sides"), nb::arg("runs").none(), nb::arg("fine_limit"), nb::arg("every"), nb::arg("threads"),
      "Rows of the visible cuts of a range of limits, those from which on and up to which each is drawn, and the number of rows "
      "visited.");
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
