"""The level-of-detail tree over the rows of a scene, and the blocks in which it is walked.

Rows are in depth-first preorder, so a subtree is the range ``[i, subtree_end[i])``: a block, a cluster or a streamed chunk is
a contiguous range, nothing is ever gathered, and the exact cut needs one prefix maximum over ``subtree_end``.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from splatree.constants import BLOCK_STEPS, BLOCKS_PER_GROUP
from splatree.errors import ShapeError
from splatree.scene.levels import LevelRecord
from splatree.scene.roots import Roots
from splatree.shapes import Array, Bool, Float32, Int32, UInt8, check_fields, in_short

_ROWS_AT_ONCE = 1 << 16

_DISAGREE = "GaussianTree: subtree_end and depth disagree; wanted nested subtrees in preorder"


@dataclass(frozen=True, eq=False)
class GaussianTree:
    """A forest over ``n`` rows in depth-first preorder; a flat scene is a forest of leaves.

    Example:
        >>> tree = scene.tree
        >>> tree.num_leaves < len(tree), int(tree.depth.min())
        (True, 0)
    """

    subtree_end: Int32[Array, "n"]
    """One past the last row of the subtree of each row; ``i + 1`` for a leaf ``i``."""
    depth: UInt8[Array, "n"]
    """Edges from the root; 0 for a root."""
    extents: Float32[Array, "n"]
    """Size of each row, world units, which the profiles `sphere` and `pixel` compare with the distance. Levels that
    `build_lod` makes: three pixels of the width from which the row stands for its descendants. Of leaves, of linked levels and of
    files without a record: radius of a ball around the row's mean that holds the 3σ ellipsoids of the row and its descendants."""
    curves: Float32[Array, "n 4"] | None = None
    """How each node follows the pixel that it is drawn at (lod/follow.py): m, world units²; n; the mass g as it is stored;
    the dilation at that pixel, world units². 0 for leaves. None: nodes are drawn as stored."""
    record: LevelRecord | None = None
    """How the levels were made and must be drawn; None: there are no levels, or nothing is known about them."""
    roots: Roots | None = None
    """What merging must know to go on above the roots; None: it is not known, so the levels can only be built anew."""

    __repr__ = in_short

    def __post_init__(self) -> None:
        n = check_fields(self)["n"]
        if self.roots is not None and len(self.roots) != np.count_nonzero(self.depth == 0):
            raise ShapeError(
                f"GaussianTree.roots: found the state of {len(self.roots)} roots, wanted {np.count_nonzero(self.depth == 0)}"
            )
        # The true end of a row is the first later row that is not deeper. A given end at such a row is not before the true
        # one; and as each row lies in as many subtrees as it is deep, equal sums leave no room for one that is behind it.
        num_below = num_above = 0
        for run, rows in self._runs():
            end, depth = self.subtree_end[run], self.depth[run]
            wrong = np.flatnonzero((end <= rows) | (end > n))
            if len(wrong):
                i = int(wrong[0])
                raise ShapeError(f"GaussianTree.subtree_end[{rows[i]}]: found {end[i]}, wanted {rows[i] + 1} to {n}")
            before = np.append(self.depth[run.start - 1] if run.start else -1, depth[:-1]).astype(np.int16)
            if np.any(depth > before + 1):
                raise ShapeError("GaussianTree.depth: found a jump of more than one level, wanted depth-first preorder")
            if not np.all(self.depth[end[end < n]] <= depth[end < n]):
                raise ShapeError(_DISAGREE)
            num_below += int((end - rows - 1).sum(dtype=np.int64))
            num_above += int(depth.sum(dtype=np.int64))
        if num_below != num_above:
            raise ShapeError(_DISAGREE)

    def __len__(self) -> int:
        return len(self.subtree_end)

    @property
    def is_leaf(self) -> Bool[Array, "n"]:
        """Whether each row has no children."""
        is_leaf = np.empty(len(self), bool)
        for run, rows in self._runs():
            np.equal(self.subtree_end[run], rows + 1, out=is_leaf[run])
        return is_leaf

    @property
    def num_leaves(self) -> int:
        """Number of rows without children."""
        return sum(int((self.subtree_end[run] == rows + 1).sum()) for run, rows in self._runs())

    @property
    def num_levels(self) -> int:
        """Largest depth + 1; 0 for an empty tree."""
        return int(self.depth.max()) + 1 if len(self) else 0

    def _runs(self) -> Iterator[tuple[slice, Int32[Array, "m"]]]:
        """Rows in runs, so that what is made of them beside takes little."""
        for first in range(0, len(self), _ROWS_AT_ONCE):
            last = min(first + _ROWS_AT_ONCE, len(self))
            yield slice(first, last), np.arange(first, last, dtype=np.int32)


@dataclass(frozen=True, eq=False)
class BlockIndex:
    """Blocks of consecutive rows, and groups of 64 blocks, with what the selection asks of a whole block.

    Any ancestor of a row in a block that lies before the block is an ancestor of the block's first row; the bounds are those
    of the block's own rows, not of descendants in later blocks.
    """

    rows_per_block: int
    """Rows of each block but the last."""
    lower: Float32[Array, "b 3"]
    """Smallest coordinates of the means in each block, world units."""
    upper: Float32[Array, "b 3"]
    """Largest coordinates."""
    leaf_scales: Float32[Array, "b"]
    """Largest standard deviation of the leaves, and of rows whose 3σ is more than their extent, world units; 0 without any."""
    step_extents: Float32[Array, "b s"]
    """Extents, ascending, from 0; ∞ for steps that there are not."""
    step_scales: Float32[Array, "b s"]
    """As ``leaf_scales``, of leaves and of the rows whose extents are less than the next of ``step_extents``: the rows that are
    drawn, where larger ones are not."""
    min_logits: Float32[Array, "b"]
    """Smallest logit opacity."""
    ancestor_start: Int32[Array, "b+1"]
    """Ancestors of the first row of block ``i``: ``ancestors[ancestor_start[i] : ancestor_start[i + 1]]``."""
    ancestors: Int32[Array, "a"]
    """Rows, from the root down."""
    group_lower: Float32[Array, "g 3"]
    """As ``lower``, of groups."""
    group_upper: Float32[Array, "g 3"]
    """As ``upper``, of groups."""
    group_leaf_scales: Float32[Array, "g"]
    """As ``leaf_scales``, of groups."""
    size_classes: UInt8[Array, "n"]
    """255 for a leaf; else the whole part of 8 log₂ σ + 128, held in 0 to 254; σ is the row's middle standard deviation or a
    third of its extent, the lesser. 254 for an inner row without a place: its mean is not a number."""

    __repr__ = in_short

    def __post_init__(self) -> None:
        sizes = check_fields(self)
        if sizes["b"] != -(-sizes["n"] // max(self.rows_per_block, 1)):
            raise ShapeError(
                f"BlockIndex: found {sizes['b']} blocks of {self.rows_per_block} rows for {sizes['n']} size classes"
            )
        if not 16 <= self.rows_per_block <= 1024:
            raise ShapeError(f"BlockIndex.rows_per_block: found {self.rows_per_block}, wanted 16 to 1024")
        if sizes["s"] != BLOCK_STEPS:
            raise ShapeError(f"BlockIndex: found {sizes['s']} steps of scales, wanted {BLOCK_STEPS}")
        if sizes["g"] != -(-sizes["b"] // BLOCKS_PER_GROUP):
            raise ShapeError(
                f"BlockIndex: found {sizes['g']} groups, wanted one for {BLOCKS_PER_GROUP} of {sizes['b']} blocks"
            )
        start, first = self.ancestor_start, np.arange(sizes["b"], dtype=np.int64) * self.rows_per_block
        if start[0] != 0 or start[-1] != len(self.ancestors) or np.any(np.diff(start) < 0):
            raise ShapeError("BlockIndex.ancestor_start: wanted 0 to the number of ancestors, ascending")
        if np.any(self.ancestors < 0) or np.any(self.ancestors >= np.repeat(first, np.diff(start))):
            raise ShapeError("BlockIndex.ancestors: found rows that are not before their block")

    def __len__(self) -> int:
        return len(self.lower)

    def fits(self, means: Array, tree: GaussianTree) -> bool:
        """Whether it is the index of this tree with these means, by its number of rows and its first and last block."""
        if len(self.size_classes) != len(tree):
            return False
        for block in {0, len(self) - 1} if len(self) else ():
            begin = block * self.rows_per_block
            rows = slice(begin, begin + self.rows_per_block)
            is_leaf = tree.subtree_end[rows] == np.arange(begin, begin + len(means[rows])) + 1
            lower = np.fmin.reduce(means[rows], initial=np.inf)  # NaN is passed over
            upper = np.fmax.reduce(means[rows], initial=-np.inf)
            if (
                np.any(lower != self.lower[block])
                or np.any(upper != self.upper[block])
                or np.any(is_leaf != (self.size_classes[rows] == 255))
            ):
                return False
        return True

    @property
    def nbytes(self) -> int:
        """Bytes of all columns."""
        return sum(value.nbytes for value in vars(self).values() if isinstance(value, np.ndarray))
