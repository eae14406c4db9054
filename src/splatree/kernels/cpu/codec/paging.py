"""The order of a tree's nodes for viewers that load pages; `kernels/reference/paging.py` is its definition."""

import numpy as np

from splatree.kernels.cpu import _core
from splatree.kernels.reference.paging import PAGE_ROWS
from splatree.shapes import Array, Float32, Int32

__all__ = ["PAGE_ROWS", "page_order"]


def page_order(
    means: Float32[Array, "n 3"],
    sizes: Float32[Array, "n"],
    subtree_end: Int32[Array, "n"],
    first_number: int,
    *,
    page_rows: int = PAGE_ROWS,
) -> Int32[Array, "n"]:
    """The rows of a preorder tree in the order of their numbers; row ``page_order[i]`` has the number ``first_number + i``."""
    order = np.empty(len(sizes), np.int32)
    _core.page_order(means, sizes, subtree_end, first_number, page_rows, order)
    return order
