"""The order of a tree's nodes in which a viewer that loads pages needs few of them: the definition.

A page is ``page_rows`` consecutive nodes, and the children of a node follow each other. Pages are filled batch by batch, as in
Spark (`chunk_tree.rs`). A batch is a set of nodes that have their numbers already; the first is the roots. The largest node of a
batch gets its children numbered, they join the batch, and so on, up to the first border between pages that lies at least an
eighth of a page beyond the start of the batch. The nodes that are left are halved by the place of their centres, along the axis
on which the middle nine tenths of them reach farthest, and each half is a later batch.

A family that would pass the border is passed over for a smaller one, and so is one that would leave a single row. So pages are
filled to the last row. In Spark such a family ends the batch, and the largest family of another region begins in the rows that
are left: most views of that region load a page for it alone.

So a page holds the large nodes of one region. Spark divides a batch at the middle of its box, which a few far nodes move: of a
city with surroundings most nodes then stay together, and a view loads pages of more than it sees. With halves of equally many
nodes it loads fewer (docs/how-to/publish-a-stream.md).
"""

import heapq
from collections.abc import Callable

import numpy as np

from splatree.shapes import Array, Float32, Int32

__all__ = ["PAGE_ROWS", "halves", "page_order"]

PAGE_ROWS = 1 << 16
"""Nodes of a page of a ``.rad``."""

_FAR_OUT = 20
"""One in so many nodes at either end of an axis does not count for how far a batch reaches."""


def halves(means: Array, rows: list[int]) -> list[list[int]]:
    """The rows of a batch in two parts that lie together."""
    if len(rows) < 2:
        return [rows] if rows else []
    centers = means[rows]
    edge = len(rows) // _FAR_OUT
    places = np.sort(centers, axis=0)
    axis = int((places[-1 - edge] - places[edge]).argmax())
    order = np.argsort(centers[:, axis], kind="stable")  # of equal places the smaller row is first
    by_place = [rows[i] for i in order]
    middle = len(rows) // 2
    return [by_place[:middle], by_place[middle:]]


def page_order(
    means: Float32[Array, "n 3"],
    sizes: Float32[Array, "n"],
    subtree_end: Int32[Array, "n"],
    first_number: int,
    *,
    page_rows: int = PAGE_ROWS,
    divide: Callable[[Array, list[int]], list[list[int]]] = halves,
    fills: bool = True,
) -> Int32[Array, "n"]:
    """The rows of a preorder tree in the order of their numbers; row ``page_order[i]`` has the number ``first_number + i``.

    Larger ``sizes`` come first, and of equal ones the smaller row. ``divide`` makes parts of the rows that a batch leaves.
    Without ``fills`` a family that would pass the border ends its batch.
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
        waiting: list[int] = []
        while heap and (is_first or first_number + len(order) < end):
            _, row = heapq.heappop(heap)
            room = end - first_number - len(order) - len(children[row])
            if is_first or (room >= 0 and not (fills and room == 1)):
                order += children[row]
                for child in children[row]:
                    if children[child]:
                        heapq.heappush(heap, (-sizes[child], child))
            else:
                waiting.append(row)
                if not fills:
                    break
            is_first = False
        batches += divide(means, sorted(waiting + [row for _, row in heap]))
    return np.array(order, np.int32)
