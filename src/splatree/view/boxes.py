"""Boxes of what a scene is divided into, to be drawn over its picture."""

from typing import Literal

import numpy as np

from splatree.scene.scene import Scene
from splatree.shapes import Array, Float64, Int32
from splatree.stream.chunks import chunks_of_tree

__all__ = ["BoxKind", "boxes_of"]

BoxKind = Literal["blocks", "chunks", "clusters"]
"""Blocks of the selection, chunks of a stream, clusters of culling."""


def boxes_of(scene: Scene, kind: BoxKind, rows: Int32[Array, "v"], most: int) -> Float64[Array, "b 2 3"]:
    """Corners of the boxes that hold some of the rows, ``most`` at most, evenly chosen; none where a scene has no such parts."""
    if len(rows) == 0:
        return np.zeros((0, 2, 3))
    if kind == "clusters" and scene.clusters is not None:
        found = np.unique(np.searchsorted(scene.clusters.start, rows, side="right") - 1)
        low, high = scene.clusters.box_low, scene.clusters.box_high
    elif kind == "blocks" and scene.blocks is not None:
        found = np.unique(rows // scene.blocks.rows_per_block)
        low, high = scene.blocks.lower, scene.blocks.upper
    elif kind == "chunks":
        chunks = chunks_of_tree(scene)
        at = np.searchsorted(chunks.start, rows, side="right") - 1
        inside = (at >= 0) & (rows < chunks.end[np.maximum(at, 0)])  # nodes of the spine are in no chunk
        found = np.unique(at[inside])
        means = scene.gaussians.means
        runs = [means[chunks.start[i] : chunks.end[i]] for i in range(len(chunks))]
        low, high = (np.stack([bound(run, axis=0) for run in runs]) for bound in (np.min, np.max))
    else:
        return np.zeros((0, 2, 3))
    found = found[:: max(1, -(-len(found) // most))]
    return np.stack([low[found], high[found]], axis=1).astype(np.float64)
