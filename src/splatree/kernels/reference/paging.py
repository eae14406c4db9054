"""The order of a tree's nodes in which a viewer that loads pages needs few of them: the definition.

A page is ``page_rows`` consecutive nodes, and the children of a node follow each other. Spark (`chunk_tree.rs`) fills pages
batch by batch. A batch is a set of nodes that have their numbers already; the first is the roots. The largest node of the batch
gets its children numbered, they join the batch, and so on, until the next family would pass the first border between pages that
lies at least an eighth of a page beyond the start of the batch. The nodes that are left are split by the place of their centres,
into halves along an axis when their box is long, else into octants, and each part is a later batch.

So a page holds the large nodes of one region: a view that refines some regions loads the pages of these regions alone.
"""

import heapq

import numpy as np

from splatree.shapes import Array, Float32, Int32

__all__ = ["PAGE_ROWS", "page_order"]

PAGE_ROWS = 1 << 16
"""Nodes of a page of a ``.rad``."""

_LONG = 3.0
"""A box is cut along its longest side alone if that is so many times its shortest."""
_OCTANTS = (0, 1, 3, 2, 6, 7, 5, 4)
"""Order of the octants: each shares a face with the next."""


def page_order(
    means: Float32[Array, "n 3"],
    sizes: Float32[Array, "n"],
    subtree_end: Int32[Array, "n"],
    first_number: int,
    *,
    page_rows: int = PAGE_ROWS,
) -> Int32[Array, "n"]:
    """The rows of a preorder tree in the order of their numbers; row ``page_order[i]`` has the number ``first_number + i``.

    Larger ``sizes`` come first, and of equal ones the smaller row.
    """
    n = len(sizes)
    roots: list[int] = []
    children: list[list[int]] = [[] for _ in range(n)]
    open_rows: list[int] = []
    for row in range(n):
        while open_rows and subtree_end[open_rows[-1]] <= row:
            open_rows.pop()
        (children[open_rows[-1]] if open_rows else roots).append(row)
        open_rows.append(row)

    order = list(roots)
    batches = [roots]
    for batch in batches:  # it grows while it is gone through
        heap = [(-sizes[row], row) for row in batch if children[row]]
        heapq.heapify(heap)
        start = first_number + len(order)
        end = -(-(start + page_rows // 8) // page_rows) * page_rows
        is_first = True  # a family that fits nowhere begins a batch
        while heap and (is_first or first_number + len(order) + len(children[heap[0][1]]) <= end):
            _, row = heapq.heappop(heap)
            order += children[row]
            for child in children[row]:
                if children[child]:
                    heapq.heappush(heap, (-sizes[child], child))
            is_first = False
        batches += _parts(means, [row for _, row in heap])
    return np.array(order, np.int32)


def _parts(means: Array, rows: list[int]) -> list[list[int]]:
    """Rows that lie together; empty parts are left out."""
    if not rows:
        return []
    centers = means[rows]
    low, high = centers.min(axis=0), centers.max(axis=0)
    middle, extents = (low + high) * np.float32(0.5), high - low
    if float(extents.max()) >= _LONG * float(extents.min()):
        is_high = (centers >= middle)[:, int(extents.argmax())]
        parts = sorted(
            ([row for row, high in zip(rows, is_high, strict=True) if high == side] for side in (False, True)),
            key=lambda part: -len(part),
        )
    else:
        octants = (centers >= middle) @ np.array([1, 2, 4])
        parts = [[row for row, o in zip(rows, octants, strict=True) if o == octant] for octant in _OCTANTS]
    return [part for part in parts if part]
