"""Forests in two layouts: links from parents to children, as files have them, and rows in depth-first preorder.

Links: node i has the children ``first_child[i] … first_child[i] + num_children[i] − 1``. Preorder: the subtree of row i is the
range ``[i, subtree_end[i])``. Rows sorted by depth, and in each depth by row, are a breadth-first numbering in which children
follow each other; so preorder becomes links by one stable sort, and links become preorder by one walk down (places) after one
walk up (sizes). Cost: a few vectorised passes over each level.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from splatree.errors import InputError
from splatree.shapes import Array, Float32, Int32, UInt8

__all__ = [
    "Links",
    "Preorder",
    "depth_from_ends",
    "ends_from_depth",
    "family_extremes",
    "links_from_preorder",
    "parents_by_level",
    "preorder_from_links",
    "subtree_radii",
]

DEPTH_MAX = 255
"""Edges from a root; a depth is kept in a byte."""


_ROWS_AT_ONCE = 1 << 16


@dataclass(frozen=True, eq=False)
class Links:
    """A forest as links, nodes in breadth-first order."""

    row_from_node: Int32[Array, "n"]
    """Preorder row of each node."""
    parents: Int32[Array, "n"]
    """Node of each node's parent; −1 for a root."""
    first_child: Int32[Array, "n"]
    """Node of the first child; 0 for a leaf."""
    num_children: Int32[Array, "n"]
    """Children, which follow each other."""


@dataclass(frozen=True, eq=False)
class Preorder:
    """A forest in depth-first preorder."""

    node_from_row: Int32[Array, "n"]
    """Node of each row."""
    subtree_end: Int32[Array, "n"]
    """One past the last row of the subtree of each row."""
    depth: UInt8[Array, "n"]
    """Edges from the root."""


def links_from_preorder(depth: Array) -> Links:
    """Number the rows of a forest breadth-first; siblings and roots keep their order."""
    n = len(depth)
    row_from_node = np.argsort(depth, kind="stable").astype(np.int32)
    node_from_row = np.empty(n, np.int32)
    node_from_row[row_from_node] = np.arange(n, dtype=np.int32)
    parents = np.full(n, -1, np.int32)
    for rows, parent_rows in parents_by_level(depth):
        parents[node_from_row[rows]] = node_from_row[parent_rows]
    num_roots = int(np.searchsorted(depth[row_from_node], 1)) if n else 0
    num_children = np.bincount(parents[num_roots:], minlength=n).astype(np.int32)
    first_child = num_roots + np.cumsum(num_children, dtype=np.int32) - num_children
    first_child[num_children == 0] = 0
    return Links(row_from_node, parents, first_child, num_children)


def parents_by_level(depth: Array) -> Iterator[tuple[Array, Array]]:
    """Rows below the roots with the rows of their parents: parents before children, in each step rows of one depth, ascending.

    A step has rows of a run of 65,536, so it takes no memory that grows with the forest.
    """
    last = np.full(DEPTH_MAX + 1, -1, np.int32)  # the last row of each depth before the run
    for begin in range(0, len(depth), _ROWS_AT_ONCE):
        run, above = depth[begin : begin + _ROWS_AT_ONCE], last[:0]
        for level in range(int(run.max()) + 1):
            here = np.flatnonzero(run == level).astype(np.int32) + np.int32(begin)
            if level and len(here):
                yield here, above[np.searchsorted(above, here) - 1]  # the last row of the level above that lies before
            above = np.append(last[level], here)
            last[level] = above[-1]


def ends_from_depth(depth: Array) -> Int32[Array, "n"]:
    """One past the last row of the subtree of each row of a forest in depth-first preorder."""
    sizes = np.ones(len(depth), np.int32)
    for rows, parents in reversed(list(parents_by_level(depth))):
        np.add.at(sizes, parents, sizes[rows])
    return np.arange(len(depth), dtype=np.int32) + sizes


def depth_from_ends(ends: Array) -> UInt8[Array, "n"]:
    """Depth of each row of a forest in depth-first preorder, from one past the last row of each subtree; at most 255."""
    closed = np.bincount(ends, minlength=len(ends) + 1)[: len(ends)]  # subtrees that end before each row
    return np.clip(np.arange(len(ends)) - np.cumsum(closed), 0, DEPTH_MAX).astype(np.uint8)


def preorder_from_links(first_child: Array, num_children: Array, roots: Array) -> Preorder:
    """Depth-first preorder of all nodes; siblings and roots keep their order.

    Raises:
        InputError: a link leaves the nodes, a node has two parents or is its own ancestor, a node is not reached from the
            roots, or one is deeper than 255.
    """
    n = len(first_child)
    wrong = (num_children < 0) | (num_children > n)
    wrong |= (num_children > 0) & ((first_child < 0) | (first_child > n - num_children.astype(np.int64)))
    if wrong.any():
        i = int(np.argmax(wrong))
        raise InputError(
            f"node {i}: found {num_children[i]} children from node {first_child[i]}, wanted nodes 0 to {n - 1}"
        )
    first, count = first_child.astype(np.int32), num_children.astype(np.int32)
    levels, fans = [roots.astype(np.int32)], []
    num_reached = len(roots)
    while True:
        fan = count[levels[-1]]
        num_reached += int(fan.sum(dtype=np.int64))
        if num_reached > n:
            raise InputError("links of nodes: found a node that is the child of two or its own ancestor, wanted a tree")
        fans.append(fan)
        if not fan.any():
            break
        if len(levels) > DEPTH_MAX:
            raise InputError(f"links of nodes: found a node deeper than {DEPTH_MAX}, wanted at most {DEPTH_MAX}")
        levels.append(_ranges(first[levels[-1]], fan))
    is_reached = np.zeros(n, bool)
    for nodes in levels:
        is_reached[nodes] = True
    if not is_reached.all():  # at most n ways lead to nodes, so if none is missed, none is met twice
        times_reached = np.bincount(np.concatenate(levels), minlength=n)
        i = int(np.argmax(times_reached != 1))
        found = "no" if times_reached[i] == 0 else "several"
        raise InputError(f"node {i}: found {found} ways to it from the roots, wanted one: the nodes are no tree")
    del is_reached

    size, row, depth = np.ones(n, np.int32), np.zeros(n, np.int32), np.zeros(n, np.uint8)
    for nodes, fan, children in zip(levels[-2::-1], fans[-2::-1], levels[:0:-1], strict=True):
        inner = fan > 0
        size[nodes[inner]] += np.add.reduceat(size[children], (np.cumsum(fan) - fan)[inner])
    row[roots] = np.cumsum(size[roots]) - size[roots]
    for level, (nodes, fan, children) in enumerate(zip(levels[:-1], fans[:-1], levels[1:], strict=True)):
        sizes = size[children]
        before = np.cumsum(sizes) - sizes
        inner = fan > 0
        row[children] = np.repeat(row[nodes[inner]] + 1 - before[(np.cumsum(fan) - fan)[inner]], fan[inner]) + before
        depth[children] = level + 1
    node_from_row = np.empty(n, np.int32)
    node_from_row[row] = np.arange(n, dtype=np.int32)
    return Preorder(node_from_row, (row + size)[node_from_row], depth[node_from_row])


def _ranges(first: Array, count: Array) -> Array:
    """first[0], first[0] + 1, … (count[0] of them), first[1], …"""
    before = np.cumsum(count, dtype=np.int32) - count
    ranges = np.repeat(first - before, count)
    ranges += np.arange(len(ranges), dtype=np.int32)
    return ranges


def subtree_radii(means: Array, reach: Array, depth: Array) -> Float32[Array, "n"]:
    """Radius of a ball around each mean that holds the balls of ``reach`` around its own mean and all its descendants'.

    max(reach, max over children c of |x_c − x| + radius_c), in float64, rounded upwards to float32.
    """
    radii = reach.astype(np.float64)
    for rows, parents in reversed(list(parents_by_level(depth))):
        apart = np.take(means, rows, axis=0).astype(np.float64) - np.take(means, parents, axis=0)
        distances = np.sqrt(np.einsum("ij,ij->i", apart, apart))
        family, start = np.unique(parents, return_index=True)
        radii[family] = np.maximum(radii[family], np.maximum.reduceat(distances + radii[rows], start))
    largest = np.finfo(np.float32).max
    # Float64 rounding of the sums, once a level, stays far below this rounding upwards.
    return np.nextafter(np.minimum(radii * (1 + 1e-9), largest).astype(np.float32), largest)


def family_extremes(low: Array, high: Array, depth: Array) -> None:
    """Lower ``low`` and raise ``high`` (n 3) of each row to those of its descendants, in place."""
    for rows, parents in reversed(list(parents_by_level(depth))):
        family, start = np.unique(parents, return_index=True)
        low[family] = np.minimum(low[family], np.minimum.reduceat(low[rows], start))
        high[family] = np.maximum(high[family], np.maximum.reduceat(high[rows], start))
