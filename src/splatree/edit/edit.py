"""Edits of a scene: of its rows alone, chunk by chunk, or of a scene with its tree.

Cost: one pass over the columns that an edit touches; the order needs a sort of all rows.
"""

import json
import math
from dataclasses import replace

import numpy as np

from splatree.edit.options import EditOptions
from splatree.edit.rows import in_morton_order, keep_leaves
from splatree.edit.similarity import Move, move_from_options
from splatree.kernels.cpu.frame.blocks import index_blocks
from splatree.scene.arguments import checked
from splatree.scene.gaussians import Gaussians
from splatree.scene.given import given
from splatree.scene.levels import has_extents_of_levels
from splatree.scene.origin import Origin
from splatree.scene.scene import Scene, Source
from splatree.shapes import Array, Bool, Float32

__all__ = ["edit", "edit_rows", "kept_rows", "merged_lost", "move_from_options", "with_loss"]


@checked
def edit(scene: Scene, options: EditOptions) -> Scene:
    """Filter, move, turn, scale, crop and order a scene, in the order that `EditOptions` states.

    Moving keeps the tree. Filters decide about leaves: a merged node stays if all leaves below it stay.

    Args:
        scene: any scene.
        options: the edits.

    Returns:
        The edited scene. ``source.metadata["lost"]`` says how many merged nodes and clusters were dropped.

    Raises:
        InputError: the order `morton` is asked for, but the scene has levels.

    Example:
        >>> turned = st.edit(scene, st.EditOptions(rotate=(90, 0, 0), min_opacity=0.05))
        >>> len(turned) <= len(scene)
        True
    """
    options = given(options, EditOptions, "edit: options")
    move = move_from_options(options, scene.source.origin)
    similarity = move.similarity
    clusters = scene.clusters
    moved = similarity.moved(scene.gaussians)
    if options.may_drop_rows:
        is_kept = kept_rows(scene.gaussians, moved, options, move.origin)
        num_merged = len(scene) - scene.tree.num_leaves
        kept = keep_leaves(scene, is_kept)
        moved = similarity.moved(kept.gaussians) if len(kept) < len(scene) else moved
        lost_merged = num_merged - (len(kept) - kept.tree.num_leaves)
        scene = kept
        if lost_merged:
            scene = replace(scene, source=with_loss(scene.source, merged_lost(lost_merged, num_merged)))
    gaussians = scene.gaussians.with_sh_degree(min(options.sh_degree, scene.gaussians.sh_degree))
    if not similarity.is_identity:
        gaussians = similarity.gaussians(gaussians, moved)
    if gaussians is not scene.gaussians:
        # Balls around leaves alone follow from what they are, and no rounding has to be covered.
        is_flat = bool(scene.tree.is_leaf.all())
        reach = similarity.reach(moved)
        is_level = ~scene.tree.is_leaf & has_extents_of_levels(scene.tree.record)
        extents = (
            Scene.flat(gaussians).tree.extents if is_flat else similarity.extents(scene.tree.extents, reach, is_level)
        )
        record = None if scene.tree.record is None else scene.tree.record.scaled(similarity.scale)
        kept_clusters = scene.clusters if similarity.is_identity else None  # harmonics alone move nothing
        tree = replace(
            scene.tree, extents=extents, curves=similarity.curves(scene.tree.curves), record=record, roots=None
        )
        blocks = None if scene.blocks is None else index_blocks(gaussians, tree)
        scene = replace(scene, gaussians=gaussians, tree=tree, blocks=blocks, clusters=kept_clusters)
    metadata = similarity.metadata(scene.source.metadata)
    scene = replace(scene, source=replace(scene.source, metadata=metadata, origin=move.origin))
    if options.order == "morton":
        scene = in_morton_order(scene)
    if clusters is not None and scene.clusters is None:
        said = f"the {len(clusters):,} clusters: they held the scene before the edit; make new ones"
        scene = replace(scene, source=with_loss(scene.source, said))
    return scene


def edit_rows(gaussians: Gaussians, options: EditOptions, move: Move) -> Gaussians:
    """As `edit`, of a chunk of a flat scene, by the ``move`` of the options and its origin; the order is not looked at."""
    similarity = move.similarity
    g = gaussians.with_sh_degree(min(options.sh_degree, gaussians.sh_degree))
    moved = similarity.moved(g)
    if options.may_drop_rows:
        is_kept = kept_rows(g, moved, options, move.origin)
        if not is_kept.all():
            g, moved = g.take(is_kept), moved[is_kept]
    return g if similarity.is_identity else similarity.gaussians(g, moved)


def kept_rows(g: Gaussians, moved: Float32[Array, "n 3"], options: EditOptions, origin: Origin) -> Bool[Array, "n"]:
    """Rows that pass all filters; ``moved`` are their means after the move, relative to ``origin``."""
    kept = np.ones(len(g), bool)
    if options.min_opacity > 0:
        kept &= g.logit_opacities >= np.float32(math.log(options.min_opacity / (1 - options.min_opacity)))
    if options.crop_box is not None:
        low, high = np.asarray(options.crop_box).reshape(2, 3) - np.asarray(origin)
        kept &= ((moved >= low) & (moved <= high)).all(axis=1)
    if options.crop_sphere is not None:
        *centre, radius = options.crop_sphere
        kept &= np.square(moved - (np.asarray(centre) - np.asarray(origin))).sum(axis=1) <= radius * radius
    return kept


def merged_lost(num_lost: int, num_merged: int) -> str:
    """That so many merged nodes went with leaves below them, as a sentence."""
    return f"{num_lost:,} of {num_merged:,} merged nodes: Gaussians below them were dropped"


def with_loss(source: Source, sentence: str) -> Source:
    """The source with one more sentence on what was lost."""
    lost = [*json.loads(source.metadata.get("lost", "[]")), sentence]
    return replace(source, metadata={**source.metadata, "lost": json.dumps(lost)})
