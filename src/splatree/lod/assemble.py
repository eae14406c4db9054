"""From a grown forest to a scene: rows in preorder, harmonics averaged, identities, the record of its levels.

Harmonics above DC take no part in the grouping. They are averaged here, in place, where children follow their parent.
"""

import dataclasses
import json
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from splatree.kernels.cpu.build import merge as merge_kernel
from splatree.kernels.cpu.frame.blocks import index_blocks
from splatree.lod.follow import with_curves
from splatree.lod.forest import Forest
from splatree.lod.order import Order, preorder
from splatree.lod.resolve import ResolvedBuild
from splatree.scene.gaussians import Gaussians
from splatree.scene.levels import LevelRecord
from splatree.scene.roots import Roots
from splatree.scene.scene import Scene, Source
from splatree.scene.thinning import rules_of
from splatree.scene.tree import GaussianTree
from splatree.shapes import Array, Float32, Int64

__all__ = ["assemble"]


def assemble(
    forest: Forest,
    scene: Scene,
    resolved: ResolvedBuild,
    *,
    seen: Float32[Array, "n"] | None = None,
    harmonics: Callable[[Int64[Array, "m"]], Float32[Array, "m k 3"]] | None = None,
    threads: int = 0,
) -> Scene:
    """The scene with the levels of a forest that grew over its Gaussians.

    Args:
        forest: what `grow` made of `forest_of_leaves` of the same scene.
        scene: the flat scene; its Gaussians become the leaves, bit for bit.
        resolved: what was decided for the whole scene.
        seen: visibility of each leaf in the order of its rank, by which merged Gaussians follow the pixel that they are drawn
            at (lod/follow.py); None: they are drawn as they were merged.
        harmonics: gives those of some Gaussians of the scene, in a new array; None: the scene has them.
        threads: threads to use; 0: all.

    Returns:
        The scene with its tree. ``tree.roots`` holds what it takes to grow on above it (`forest_of_roots`).
    """
    order = order_of(forest)
    row = order.row_from_node
    num_leaves, n = len(scene), len(row)
    node_from_row = np.empty(n, np.intp)
    node_from_row[row] = np.arange(n)

    def placed(parts: list[Array]) -> Array:
        return np.take(np.concatenate(parts), node_from_row, axis=0)

    row_from_leaf = np.empty(num_leaves, np.int32)
    row_from_leaf[forest.base.order] = row[:num_leaves]
    leaf_from_row = np.zeros(n, np.int64)  # inner nodes take any leaf's harmonics, and then their children's mean
    leaf_from_row[row_from_leaf] = np.arange(num_leaves)
    sh = np.take(scene.gaussians.sh, leaf_from_row, axis=0) if harmonics is None else harmonics(leaf_from_row)
    merge_kernel.average_children(sh, order.tree.subtree_end, placed(list(forest.weights)), threads=threads)
    gaussians = Gaussians(
        placed([part.means for part in forest.columns]),
        placed([part.quats for part in forest.columns]),
        placed([part.log_scales for part in forest.columns]),
        placed([part.logit_opacities for part in forest.columns]),
        sh,
    )
    leaf_ids = _leaf_ids(forest, scene)
    first_id = int(leaf_ids.max()) + 1 if num_leaves else 0
    if first_id + n - num_leaves > 2**32:  # no room above the largest: number all rows anew
        leaf_ids, first_id = np.arange(num_leaves, dtype=np.uint32), num_leaves
    ids = np.empty(n, np.uint32)
    ids[row_from_leaf] = leaf_ids
    ids[row[num_leaves:]] = np.arange(first_id, first_id + n - num_leaves, dtype=np.uint32)
    tree = dataclasses.replace(
        order.tree, record=record_of(resolved, forest.sizes), roots=roots_of(forest, order, resolved)
    )
    if seen is not None and n > num_leaves:
        seen_from_row = np.ones(n, np.float32)
        seen_from_row[row[:num_leaves]] = seen
        pixels = resolved.judged_size, resolved.stored_size
        gaussians, tree = with_curves(gaussians, tree, seen_from_row, pixels=pixels, threads=threads)
    source = with_report(scene.source, resolved, list(forest.sizes), {"nodes": list(forest.counts)})
    return with_tree(scene, gaussians, tree, ids, source, threads=threads)


def _leaf_ids(forest: Forest, scene: Scene) -> Array:
    """Identities of the leaves in the order of the scene: its own, or their rows in the input of the whole build."""
    inputs = forest.base.inputs
    if scene.ids is not None:
        return scene.ids
    if inputs.max(initial=0) >= 2**32:
        return np.arange(len(scene), dtype=np.uint32)
    leaf_ids = np.empty(len(scene), np.uint32)
    leaf_ids[forest.base.order] = inputs
    return leaf_ids


def order_of(forest: Forest) -> Order:
    """The rows of a forest's nodes, as if its base nodes were leaves."""
    reach = np.concatenate([part.reach() for part in forest.columns])
    if forest.base.reaches is not None:
        reach[: len(forest.base.reaches)] = forest.base.reaches
    return preorder(forest.families, forest.roots, np.concatenate([part.means for part in forest.columns]), reach)


def record_of(resolved: ResolvedBuild, sizes: Sequence[float]) -> LevelRecord:
    """How levels of these sizes were made."""
    by_pairs = resolved.method == "pairs"
    return LevelRecord(
        rule="pairs" if by_pairs else "radius-thinning",
        profile="pixel",
        mode=resolved.mode,
        steps=tuple(sizes),
        growth=resolved.growth,
        merge=resolved.merge,
        importance=None if by_pairs else resolved.importance,
        color_radius=None if by_pairs else resolved.color_radius,
        visibility=resolved.visibility,
    )


def roots_of(forest: Forest, order: Order, resolved: ResolvedBuild) -> Roots:
    """What it takes to go on above the roots of a forest."""
    visibilities = forest.visibilities
    return Roots(
        weights=forest.root_weights,
        visibilities=np.ones(len(forest.roots), np.float32) if visibilities is None else visibilities,
        reaches=order.reaches[forest.roots],
        codes=forest.base.codes[forest.chains],
        inputs=forest.base.inputs[forest.chains],
        num_sizes=forest.num_sizes,
        log_unit=resolved.log_unit,
        grown=forest.grown,
    )


def with_report(source: Source, resolved: ResolvedBuild, sizes: list[float], counts: dict[str, Any]) -> Source:
    """The provenance with rules and counts, for people to read; clusters are those of other rows and go."""
    report: dict[str, Any] = {"growth": resolved.growth, "max_roots": resolved.max_roots}
    if resolved.method == "pairs":
        report |= {"rule": "pairs", "pixel_size": resolved.first_size, "pixel_sizes": sizes}
    else:
        report |= {"rule": "radius-thinning", "radius": resolved.first_size, "radii": sizes}
        report |= {"importance": resolved.importance, "color_radius": resolved.color_radius}
    report |= {"visibility": resolved.visibility, "merge": rules_of(resolved.merge), "mode": resolved.mode, **counts}
    metadata = {key: value for key, value in source.metadata.items() if key != "clusters"}
    return dataclasses.replace(source, metadata={**metadata, "levels": json.dumps(report)})


def with_tree(
    scene: Scene, gaussians: Gaussians, tree: GaussianTree, ids: Array, source: Source, *, threads: int
) -> Scene:
    """The scene with other rows, and the block index that belongs to them."""
    blocks = index_blocks(gaussians, tree, threads=threads)
    return dataclasses.replace(
        scene, gaussians=gaussians, tree=tree, ids=ids, blocks=blocks, clusters=None, source=source
    )
