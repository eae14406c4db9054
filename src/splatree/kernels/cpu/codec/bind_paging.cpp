#include <stdexcept>

#include "cpu/codec/paging.h"
#include "cpu/runtime/arrays.h"

namespace splatree {

using namespace nb::literals;

namespace {

void bind_page_order(const In<float>& means, const In<float>& sizes, const In<int32_t>& subtree_end, int64_t first_number,
                     int64_t page_rows, const Out<int32_t>& order) {
  const size_t n = sizes.size();
  if (means.size() != 3 * n || subtree_end.size() != n || order.size() != n || page_rows < 1)
    throw std::invalid_argument("page_order: wanted means \"n 3\", sizes, subtree_end and order \"n\", and page_rows above 0");
  nb::gil_scoped_release released;
  page_order(static_cast<int64_t>(n), means.data(), sizes.data(), subtree_end.data(), first_number, page_rows, order.data());
}

}  // namespace

void bind_paging(nb::module_& m) {
  m.def("page_order", &bind_page_order, "means"_a, "sizes"_a, "subtree_end"_a, "first_number"_a, "page_rows"_a, "order"_a);
}

}  // namespace splatree
