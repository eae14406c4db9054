"""The cut of levels of detail as a circuit would find it: a walk through the rows of each cluster, in preorder.

A node that is small on the screen stands for its subtree, so the walk goes on behind that (docs/explanation/select.md). What it
looks at are the rows that no ancestor shadows: the cut and everything above it. A row's record is 16 bytes: mean, extent and
the rows of its subtree. The walk skips lines that it does not need; four records are one line of 64 bytes.

A cluster below a node that stops has no row to look at. One bit a cluster says so on the chip, written by the clusters above.
"""

from dataclasses import dataclass

import numpy as np

from splatree.kernels.cpu.frame.select import small
from splatree.scene.frame import Frame
from splatree.scene.options import SelectOptions
from splatree.scene.scene import Scene
from splatree.shapes import Array, Bool, Int64

__all__ = ["RECORDS_PER_UNIT", "Walk", "unwalked", "walk_of"]

RECORDS_PER_UNIT = 4
"""Records of 16 bytes in 64 bytes."""


@dataclass(frozen=True, eq=False)
class Walk:
    """What the walk does in each cluster."""

    rows: Int64[Array, "c"]
    """Rows of the cut, seen or not."""
    walked: Int64[Array, "c"]
    """Rows that are looked at."""
    units: Int64[Array, "c"]
    """Pieces of 64 bytes in which their records lie."""
    is_above: Bool[Array, "c"]
    """Whether the cluster has descendants in other clusters, so that it must be walked before these."""


def walk_of(scene: Scene, frame: Frame) -> Walk:
    """Walk the clusters of a scene with levels for the view of a frame, by the radius with which the frame was drawn."""
    assert scene.clusters is not None
    tree, start = scene.tree, scene.clusters.start[:-1]
    chosen = SelectOptions(pixel_error=frame.selection.pixel_error, profile=frame.selection.profile)
    rows = np.arange(len(tree), dtype=np.int32)
    is_small = small(scene.gaussians, tree, rows, frame.view, chosen)
    # A row is shadowed if the subtree of an earlier row that stops reaches beyond it.
    reach = np.maximum.accumulate(np.where(is_small & ~tree.is_leaf, tree.subtree_end, 0))
    walked = np.concatenate([[0], reach[:-1]]) <= rows
    cut = walked & (tree.is_leaf | is_small)
    cluster = np.repeat(np.arange(len(start)), scene.clusters.counts)

    def count(of: Array) -> Int64[Array, "c"]:
        return np.bincount(cluster[of], minlength=len(start)).astype(np.int64)

    unit = rows // RECORDS_PER_UNIT
    looked_at = np.flatnonzero(walked)
    is_first = np.ones(len(looked_at), bool)  # of its cluster in its unit
    is_first[1:] = (np.diff(unit[looked_at]) > 0) | (np.diff(cluster[looked_at]) > 0)
    above = np.maximum.reduceat(tree.subtree_end, start) > scene.clusters.start[1:]
    return Walk(count(cut), count(walked), count(looked_at[is_first]), above)


def unwalked(rows: Int64[Array, "c"]) -> Walk:
    """Of a frame without levels: all of these rows are drawn, and nothing is looked at."""
    none = np.zeros_like(rows)
    return Walk(rows, none, none, np.zeros(len(rows), bool))
