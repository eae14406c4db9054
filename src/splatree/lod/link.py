"""Levels that another tool made as one tree: each Gaussian of a level hangs below its nearest one of the next coarser level.

A streamed SOG, or any series of ever coarser files, does not say which Gaussians stand for which. The nearest coarser centre is
taken as parent. A cut of the tree can then pass from level to level anywhere in space, as the selection asks for it.

But a parent is not the merge of its children; only its level is the merge of theirs. Where single nodes change their level,
some of the surface is drawn twice and some not at all. So the nodes of a level should change together. Their extents are
raised to what 99 of 100 nodes of the level need. The profile `sphere`, which decides by the extents, then changes whole
regions at a distance. With as many nodes it is as good as the file's levels where everything is equally far, and 10 dB better
where it is not.

Each inner node must stand for something; otherwise it would be a leaf that is drawn among the finer ones. A coarse Gaussian
without children adopts the nearest finer one whose parent keeps another child; if there is none, it is dropped. A node whose
only child is the same Gaussian bit for bit is dropped too: surroundings that are part of every level appear once.

Cost: one search of nearest centres a level, a few more for Gaussians without children, and the sorting into preorder.
"""

import dataclasses
import json
from collections.abc import Sequence

import numpy as np

from splatree.errors import InputError
from splatree.kernels.cpu.build.kmeans import assign
from splatree.kernels.cpu.frame.blocks import index_blocks
from splatree.lod.order import Families, preorder
from splatree.maths.morton import morton_codes
from splatree.progress import task
from splatree.scene.arguments import checked
from splatree.scene.gaussians import Gaussians
from splatree.scene.levels import LevelRecord
from splatree.scene.scene import Scene
from splatree.shapes import Array, Float32, Float64, Int32

__all__ = ["link_levels"]

_SHARE_IN_STEP = 0.99
"""Share of the nodes of a level that have the same extent, about: with less their number is lower and the picture patchy."""

_ROUNDS = 32
"""Rounds in which nodes without children look for one. A round serves at least half of them, unless many share a place."""


@checked
def link_levels(levels: Sequence[Scene], *, threads: int = 0) -> Scene:
    """Make one tree of levels that another tool made: each Gaussian hangs below its nearest one of the next coarser level.

    Args:
        levels: flat scenes, the finest first, each with at most as many Gaussians as the one before (`read_levels`).
        threads: threads to use; 0: all.

    Returns:
        One scene. Its leaves are the Gaussians of the finest level, bit for bit. ``tree.record`` says that the levels are linked:
        they are drawn by the profile `sphere`, since extents are made so that the nodes of a level change together.
        ``source.metadata["levels"]`` counts the nodes that had to take another node's child, and those that were left out.

    Raises:
        InputError: there are no levels, one has levels of its own, one is larger than the finer one before it, or they are drawn
            in different modes.

    Example:
        >>> import numpy as np
        >>> import splatree as st
        >>> n = np.arange(8, dtype=np.float32)
        >>> fine = st.Gaussians(
        ...     np.column_stack([n, 0 * n, 0 * n]), np.tile(np.float32([1, 0, 0, 0]), (8, 1)),
        ...     np.full((8, 3), -1, np.float32), np.zeros(8, np.float32), np.zeros((8, 1, 3), np.float32),
        ... )
        >>> tree = st.link_levels([st.Scene.flat(fine), st.Scene.flat(fine.take(np.array([1, 5])))])
        >>> tree.tree.num_leaves, len(tree), tree.tree.record.rule
        (8, 10, 'linked')
    """
    _check(levels)
    finest = levels[0]
    leaf_from_node = _along_curve(finest.gaussians)
    present = finest.gaussians.take(leaf_from_node)
    nodes, num_nodes = np.arange(len(present), dtype=np.int32), len(present)  # numbers of the level at hand
    columns, families = [present], list[Families]()
    num_moved = num_dropped = 0
    with task("link levels", float(len(levels))) as advance:
        advance(1.0)
        for scene in levels[1:]:
            coarse = scene.gaussians.take(_along_curve(scene.gaussians))
            parents, moved = parents_of(present.means, coarse.means, threads=threads)
            kept, parents = np.unique(parents, return_inverse=True)
            num_moved, num_dropped = num_moved + moved, num_dropped + len(coarse) - len(kept)
            coarse = coarse.take(kept)

            children = np.argsort(parents, kind="stable")
            counts = np.bincount(parents, minlength=len(kept))
            start = np.cumsum(counts) - counts
            is_new = (counts > 1) | ~_same_rows(present, children[start], coarse)
            numbers = nodes[children[start]]  # a node that is its only child moves up itself
            numbers[is_new] = np.arange(num_nodes, num_nodes + is_new.sum(), dtype=np.int32)
            in_family = np.repeat(is_new, counts)
            first_child = np.cumsum(counts[is_new]) - counts[is_new]
            families.append(Families(num_nodes, nodes[children[in_family]], first_child.astype(np.int64)))
            columns.append(coarse.take(is_new))
            nodes, num_nodes, present = numbers, num_nodes + int(is_new.sum()), coarse
            advance(1.0)

    gaussians = Gaussians.concatenate(columns)
    reach = np.concatenate([_reach(column, in_step=i > 0) for i, column in enumerate(columns)])
    order = preorder([level for level in families if len(level.start)], nodes, gaussians.means, reach)
    row = order.row_from_node
    node_from_row = np.empty(len(row), np.intp)
    node_from_row[row] = np.arange(len(row))
    ids = np.arange(len(row), dtype=np.uint32)
    ids[: len(leaf_from_node)] = leaf_from_node
    gaussians = gaussians.take(node_from_row)
    record = LevelRecord("linked", "sphere", mode=finest.mode)
    tree = dataclasses.replace(order.tree, record=record if len(levels) > 1 else None)
    report = {
        "rule": "linked",
        "nodes": [len(scene) for scene in levels],
        "moved": num_moved,
        "dropped": num_dropped,
    }
    metadata = {key: value for key, value in finest.source.metadata.items() if key != "level"}
    return dataclasses.replace(
        finest,
        gaussians=gaussians,
        tree=tree,
        ids=np.take(ids, node_from_row),
        blocks=index_blocks(gaussians, tree, threads=threads),
        source=dataclasses.replace(finest.source, metadata={**metadata, "levels": json.dumps(report)}),
    )


def parents_of(
    fine: Float32[Array, "n 3"], coarse: Float32[Array, "m 3"], *, threads: int = 0
) -> tuple[Int32[Array, "n"], int]:
    """The nearest coarse centre of each fine one, but for as many as it takes to leave few coarse ones without a child.

    Also returns how many fine ones were moved to a parent that is not their nearest.
    """
    parents = assign(fine, coarse, threads=threads).labels.astype(np.int32)
    num_moved = 0
    for _ in range(_ROUNDS):
        counts = np.bincount(parents, minlength=len(coarse))
        lonely = np.flatnonzero(counts == 0)
        spare = np.flatnonzero(counts[parents] > 1)
        if not len(lonely) or not len(spare):
            break
        found = assign(coarse[lonely], fine[spare], threads=threads)
        child = spare[found.labels]
        # Of those that want the same child, or children of the same parent, the nearest is served: no parent loses two a round.
        by_distance = np.lexsort((lonely, found.squared_distances))
        _, first = np.unique(parents[child[by_distance]], return_index=True)
        served = by_distance[first]
        parents[child[served]] = lonely[served]
        num_moved += len(served)
    return parents, num_moved


def _check(levels: Sequence[Scene]) -> None:
    if not levels:
        raise InputError("link_levels: found no levels, wanted at least one")
    for i, scene in enumerate(levels):
        if scene.tree.num_leaves != len(scene):
            raise InputError(f"link_levels: level {i} has levels of its own, wanted a flat scene")
        if scene.mode != levels[0].mode:
            raise InputError(
                f"link_levels: level {i} is {scene.mode}, those before it are {levels[0].mode}; wanted one mode"
            )
        if i and len(scene) > len(levels[i - 1]):
            raise InputError(
                f"link_levels: found {len(scene)} Gaussians in level {i} after {len(levels[i - 1])} in the level before, "
                "wanted ever fewer; give the finest level first"
            )
        if i and len(levels[i - 1]) and not len(scene):
            raise InputError(f"link_levels: level {i} is empty, wanted at least one Gaussian; leave it out")


def _along_curve(g: Gaussians) -> Array:
    return np.argsort(morton_codes(g.means), kind="stable")


def _reach(g: Gaussians, *, in_step: bool) -> Float64[Array, "n"]:
    """3σ of each row; in step with its level if it is not a leaf."""
    reach = g.reach()
    return np.asarray(np.maximum(reach, np.quantile(reach, _SHARE_IN_STEP)) if in_step and len(g) else reach)


def _same_rows(a: Gaussians, rows: Array, b: Gaussians) -> Array:
    """Whether each of the rows of ``a`` has the bits of the row of ``b``."""
    same = np.ones(len(b), bool)
    for column in dataclasses.fields(Gaussians):
        x, y = (getattr(g, column.name).reshape(len(g), -1) for g in (a, b))
        if x.shape[1] != y.shape[1]:
            return np.zeros(len(b), bool)
        same &= (x[rows] == y).all(axis=1)
    return same
