"""What a tree costs and how it branches, from the tree alone."""

from dataclasses import dataclass

import numpy as np

from splatree.scene.scene import Scene

__all__ = ["LevelReport", "report_levels"]


@dataclass(frozen=True)
class LevelReport:
    """Counts of a level-of-detail tree."""

    num_nodes: int
    """All rows."""
    num_leaves: int
    """Rows without children: the scene itself."""
    num_roots: int
    """Rows without a parent."""
    nodes_per_depth: tuple[int, ...]
    """Rows at each depth, roots first."""
    fan_out: dict[int, int]
    """Inner nodes by their number of children."""
    num_bytes: int
    """Bytes of all columns, the tree's 9 a row included."""


def report_levels(scene: Scene) -> LevelReport:
    """Count nodes per depth, children per inner node, and bytes."""
    tree = scene.tree
    depth = tree.depth.astype(np.int64)
    per_depth = np.bincount(depth) if len(tree) else np.zeros(0, np.int64)
    # In preorder the parent of a row at depth d is the last row before it at depth d − 1.
    children = np.zeros(len(tree), np.int64)
    for d in range(1, len(per_depth)):
        above, below = np.flatnonzero(depth == d - 1), np.flatnonzero(depth == d)
        children += np.bincount(above[np.searchsorted(above, below) - 1], minlength=len(tree))
    sizes, counts = np.unique(children[children > 0], return_counts=True)
    tree_bytes = tree.subtree_end.nbytes + tree.depth.nbytes + tree.extents.nbytes
    return LevelReport(
        num_nodes=len(tree),
        num_leaves=tree.num_leaves,
        num_roots=int(per_depth[0]) if len(per_depth) else 0,
        nodes_per_depth=tuple(int(c) for c in per_depth),
        fan_out={int(s): int(c) for s, c in zip(sizes, counts, strict=True)},
        num_bytes=scene.gaussians.nbytes + tree_bytes,
    )
