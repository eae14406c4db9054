"""Rows of a scene dropped or put in order, with its tree.

A node of a tree stands for its leaves; where one of them is dropped it would show what is no longer there. So a node is kept if
all leaves below it are, and the children of a dropped node become roots: every cut of what is left is a picture of the
kept leaves, and only the coarsest levels along the border are missing.
"""

from dataclasses import replace

import numpy as np

from splatree.errors import InputError
from splatree.kernels.cpu.frame.blocks import index_blocks
from splatree.maths.morton import morton_codes
from splatree.scene.scene import Scene
from splatree.scene.tree import GaussianTree
from splatree.shapes import Array, Bool, Int64

__all__ = ["in_morton_order", "keep_leaves"]


def keep_leaves(scene: Scene, is_kept: Bool[Array, "n"]) -> Scene:
    """The scene with those of its leaves that ``is_kept`` marks, and all nodes above nothing but such leaves."""
    tree = scene.tree
    dropped_before = np.concatenate([[0], np.cumsum(tree.is_leaf & ~is_kept)])
    kept = dropped_before[tree.subtree_end] == dropped_before[:-1]  # no leaf of the subtree is dropped
    rows = np.flatnonzero(kept)
    if len(rows) == len(scene):
        return scene
    row_from_old = np.concatenate([[0], np.cumsum(kept)])
    # Subtrees of kept nodes are kept whole, so the depth to subtract is that of the last root of what is kept.
    ends = tree.subtree_end[rows]
    covered = np.concatenate([[0], np.maximum.accumulate(ends)[:-1]]) if len(rows) else ends
    roots = np.maximum.accumulate(np.where(rows >= covered, np.arange(len(rows)), 0))
    depth = tree.depth[rows]
    kept_tree = GaussianTree(
        subtree_end=row_from_old[ends].astype(np.int32),
        depth=(depth - depth[roots]).astype(np.uint8),
        extents=tree.extents[rows],
        curves=None if tree.curves is None else tree.curves[rows],
        record=tree.record,
    )
    return _with_rows(scene, rows, kept_tree)


def in_morton_order(scene: Scene) -> Scene:
    """The rows of a flat scene along a Z-curve.

    Raises:
        InputError: the scene has levels: the order of its rows is that of its tree.
    """
    if scene.tree.num_leaves != len(scene):
        raise InputError(
            "order morton: found a scene with levels, whose rows are in the order of its tree; wanted a flat one"
        )
    order = np.argsort(morton_codes(scene.gaussians.means), kind="stable")
    tree = replace(
        scene.tree,
        extents=scene.tree.extents[order],
        curves=None if scene.tree.curves is None else scene.tree.curves[order],
        roots=None,
    )
    return _with_rows(scene, order, tree)


def _with_rows(scene: Scene, rows: Int64[Array, "m"], tree: GaussianTree) -> Scene:
    gaussians = scene.gaussians.take(rows)
    ids = None if scene.ids is None else scene.ids[rows]
    blocks = None if scene.blocks is None else index_blocks(gaussians, tree)
    return replace(scene, gaussians=gaussians, tree=tree, ids=ids, blocks=blocks, clusters=None)
