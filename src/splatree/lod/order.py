"""From parents and children found level by level to rows in depth-first preorder.

A level is a list of families: new nodes and, one family after the other, their children. Nodes are numbered as they appear,
leaves first, so a child's number is below its parent's; sizes and extents go up the levels, places and depths come down.
Cost: a few vectorised passes over each level.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from splatree.errors import InputError
from splatree.scene.tree import GaussianTree
from splatree.shapes import Array, Float32, Float64, Int32, Int64

__all__ = ["Families", "Order", "preorder"]


@dataclass(frozen=True, eq=False)
class Families:
    """The families that one level made."""

    first: int
    """Number of the first new node; they are consecutive."""
    children: Int32[Array, "m"]
    """Numbers of the children, family by family, in the order in which they are to stand."""
    start: Int64[Array, "f"]
    """Index into ``children`` of each family's first."""
    extents: Float32[Array, "f"] | None = None
    """Extent of each new node, world units; None: that of a ball that holds what is below."""

    @property
    def parents(self) -> Array:
        """Numbers of the new nodes."""
        return np.arange(self.first, self.first + len(self.start), dtype=np.int32)

    @property
    def fan_out(self) -> Array:
        """Children of each new node."""
        return np.diff(self.start, append=len(self.children))


@dataclass(frozen=True, eq=False)
class Order:
    """Where each node goes."""

    row_from_node: Int32[Array, "n"]
    """Row of each node."""
    tree: GaussianTree
    """The tree over the rows."""
    reaches: Float64[Array, "n"]
    """Radius of the ball around each node that holds its subtree, world units, before rounding."""


def preorder(levels: Sequence[Families], roots: Int32[Array, "r"], means: Array, reach: Array) -> Order:
    """Rows in depth-first preorder, roots and siblings in the given order.

    ``means`` (n 3) are the nodes' centres and ``reach`` (n) their own 3σ. An extent is the radius of a ball around the node's
    mean that holds its own and all descendants' 3σ ellipsoids: max(reach, max over children c of |x_c − x| + extent_c),
    never less than a child's, rounded upwards. Families with extents of their own have those in place of it.
    """
    n = len(means)
    size, extents = np.ones(n, np.int32), reach.astype(np.float64)
    for level in levels:
        parents, children = level.parents, level.children
        size[parents] += np.add.reduceat(size[children], level.start)
        parent_from_child = np.repeat(parents, level.fan_out)
        apart = np.take(means, children, axis=0).astype(np.float64) - np.take(means, parent_from_child, axis=0)
        distances = np.sqrt(np.einsum("ij,ij->i", apart, apart))
        extents[parents] = np.maximum(extents[parents], np.maximum.reduceat(distances + extents[children], level.start))
        # Float64 rounding of the sums above, once a level, stays far below the rounding upwards at the end.

    row, depth = np.zeros(n, np.int32), np.zeros(n, np.int16)
    row[roots] = np.cumsum(size[roots]) - size[roots]
    for level in reversed(levels):
        parents, children, fan_out = level.parents, level.children, level.fan_out
        sizes = size[children]
        before = np.cumsum(sizes) - sizes
        before -= np.repeat(before[level.start], fan_out)
        row[children] = np.repeat(row[parents] + 1, fan_out) + before
        depth[children] = np.repeat(depth[parents] + 1, fan_out)
    if n and depth.max() > 255:
        raise InputError(f"build: found a node {depth.max()} levels below its root, wanted at most 255; raise growth")

    extents_up = np.empty(n, np.float32)
    extents_up[row] = np.minimum(extents * (1 + 1e-9), np.finfo(np.float32).max)
    np.nextafter(extents_up, np.finfo(np.float32).max, out=extents_up)
    for level in levels:
        if level.extents is not None:
            extents_up[row[level.parents]] = level.extents
    subtree_end, depth_of_row = np.empty(n, np.int32), np.empty(n, np.uint8)
    subtree_end[row] = row + size
    depth_of_row[row] = depth
    return Order(row, GaussianTree(subtree_end, depth_of_row, extents_up), extents)
