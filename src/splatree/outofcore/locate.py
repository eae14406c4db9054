"""Where rows of the whole tree are: in which page, and which row of it.

In one file a row is in the page that begins before it. In a folder a row is a node of the crown, or it is below a copy of a root:
then it is as far behind the root in its part as it is behind the copy in the whole.
"""

from collections.abc import Callable

import numpy as np

from splatree.io.formats.splatree.rows import StoredScene
from splatree.io.pages.index import StoreIndex
from splatree.io.pages.page import Page
from splatree.outofcore.paging import Cut
from splatree.shapes import Array, Int32, Int64

__all__ = ["crown_rows", "find_rows"]


def crown_rows(index: StoreIndex, rows: Int32[Array, "v"]) -> Int64[Array, "v"]:
    """The node of the crown that each row is, or that stands for it."""
    assert index.whole_rows is not None
    return np.searchsorted(index.whole_rows, rows, side="right") - 1


def find_rows(index: StoreIndex, crown: StoredScene, page_of: Callable[[int], Page], rows: Int32[Array, "v"]) -> Cut:
    """The page of each row of the whole tree, and its place there.

    Args:
        index: of the store.
        crown: its first file.
        page_of: loads a page: those that roots begin in are looked at.
        rows: ascending.
    """
    if not index.has_parts:
        return _in_pages(index, rows, np.zeros(len(rows), np.int64), rows)
    assert index.whole_rows is not None
    nodes = crown_rows(index, rows)
    is_copy = crown.file.rows("tree.subtree_end")[nodes] == nodes + 1
    file, own = np.zeros(len(rows), np.int64), nodes.copy()
    roots, root_of_row = np.unique(crown.file.rows("ids")[nodes[is_copy]], return_inverse=True)
    first_root, num_own = index.table.first_root, index.num_own
    pages = np.searchsorted(first_root[num_own:], roots, side="right") - 1 + num_own
    starts = np.empty(len(roots), np.int64)
    for number in np.unique(pages):
        at, page = np.flatnonzero(pages == number), page_of(int(number))
        starts[at] = page.begin + np.flatnonzero(page.depth == 0)[roots[at] - first_root[number]]
    file[is_copy] = np.searchsorted(index.file_start, pages, side="right")[root_of_row] - 1
    own[is_copy] = starts[root_of_row] + rows[is_copy] - index.whole_rows[nodes[is_copy]]
    return _in_pages(index, rows, file, own)


def _in_pages(index: StoreIndex, rows: Array, file: Array, own: Array) -> Cut:
    """The pages of rows ``own`` of files."""
    pages, begin = np.empty(len(rows), np.int32), index.table.begin
    for number in np.unique(file):
        at, (first, end) = file == number, index.file_start[number : number + 2]
        pages[at] = np.searchsorted(begin[first:end], own[at], side="right") - 1 + first
    return Cut(rows.astype(np.int32), pages, (own - begin[pages]).astype(np.int32))
