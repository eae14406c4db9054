"""The level-of-detail tree over the rows of a scene, and the blocks in which it is walked.

Rows are in depth-first preorder, so a subtree is the range ``[i, subtree_end[i])``: a block, a cluster or a streamed chunk is
a contiguous range, nothing is ever gathered, and the exact cut needs one prefix maximum over ``subtree_end``.
"""

from dataclasses import dataclass

import numpy as np

from splatree.errors import ShapeError
from splatree.shapes import Array, Bool, Float32, Int32, UInt8, check_fields


@dataclass(frozen=True, eq=False)
class GaussianTree:
    """A forest over ``n`` rows; a flat scene is a forest of leaves."""

    subtree_end: Int32[Array, "n"]
    """One past the last row of the subtree of each row; a leaf has ``i + 1``."""
    depth: UInt8[Array, "n"]
    """Edges from the root; 0 for a root."""
    extents: Float32[Array, "n"]
    """Radius, world units, of a ball around the row's mean that holds the 3σ ellipsoids of the row and its descendants."""

    def __post_init__(self) -> None:
        n = check_fields(self)["n"]
        end = self.subtree_end
        rows = np.arange(n, dtype=np.int32)
        if not self.depth.any() and np.array_equal(end, rows + 1):
            return  # a forest of leaves: nothing else can be wrong
        wrong = np.flatnonzero((end <= rows) | (end > n))
        if len(wrong):
            i = int(wrong[0])
            raise ShapeError(f"GaussianTree.subtree_end[{i}]: found {end[i]}, wanted {i + 1} to {n}")
        if n and (self.depth[0] != 0 or np.any(self.depth[1:] > self.depth[:-1].astype(np.int16) + 1)):
            raise ShapeError("GaussianTree.depth: found a jump of more than one level, wanted depth-first preorder")
        # The true end of i is the first later row that is not deeper. A given end at such a row is not before the true
        # one; and as each row lies in as many subtrees as it is deep, equal sums leave no room for one that is behind it.
        inner = end[end < n]
        closes = self.depth[inner] <= self.depth[end < n]
        if not closes.all() or int((end - rows - 1).sum(dtype=np.int64)) != int(self.depth.sum(dtype=np.int64)):
            raise ShapeError("GaussianTree: subtree_end and depth disagree; wanted nested subtrees in preorder")

    def __len__(self) -> int:
        return len(self.subtree_end)

    @property
    def is_leaf(self) -> Bool[Array, "n"]:
        """Whether each row has no children."""
        return np.asarray(self.subtree_end == np.arange(1, len(self) + 1, dtype=np.int32))

    @property
    def num_leaves(self) -> int:
        """Rows without children."""
        return int(self.is_leaf.sum())

    @property
    def num_levels(self) -> int:
        """Largest depth + 1; 0 for an empty tree."""
        return int(self.depth.max()) + 1 if len(self) else 0
