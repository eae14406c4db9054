"""Level of detail: a tree whose leaves are the scene and whose inner nodes are merged Gaussians.

Level 0 is the scene. Each further level merges the nodes of the one before by a larger radius (`grow_radius.py`) or for a larger
pixel (`grow_pairs.py`): a group of two or more becomes a new node with its members as children. It ends with at most
``max_roots`` nodes. Roots and siblings stand along a Morton curve, rows in depth-first preorder.

The steps are `measure` and `resolve` (what is automatic), `forest_of_leaves`, `grow`, `assemble`. `build_lod` (render/build.py)
goes through them by the method that suits the scene, which pictures tell. A scene that is built in parts goes through the same
steps part by part, then `forest_of_roots`, `grow` and `graft` above them: docs/explanation/parts.md.

Memory: the result, plus 64 bytes a node while the levels grow.
"""

import dataclasses

import numpy as np

from splatree.lod.assemble import assemble
from splatree.lod.forest import forest_of_leaves
from splatree.lod.grow import grow
from splatree.lod.options import BuildOptions
from splatree.lod.resolve import follows_pixels, measure, resolve
from splatree.scene.scene import Scene
from splatree.simplify.merge import check_finite

__all__ = ["build_levels", "leaves_of"]


def build_levels(flat: Scene, options: BuildOptions, *, threads: int = 0) -> Scene:
    """The levels of a flat scene with identities (`leaves_of`), by a method that is named.

    Raises:
        InputError: NaN or infinity in the Gaussians, or no method is named.
    """
    check_finite(flat.gaussians)
    resolved = resolve(options, measure(flat.gaussians, options, flat.mode, threads=threads), flat.mode)
    forest = forest_of_leaves(flat, resolved, threads=threads)
    seen = None
    if follows_pixels(options, flat.mode):
        seen = np.ones(len(flat), np.float32) if forest.visibilities is None else forest.visibilities
    forest = grow(forest, resolved, threads=threads)
    return assemble(forest, flat, resolved, seen=seen, threads=threads)


def leaves_of(scene: Scene) -> Scene:
    """The leaves of a scene, with their identities, as a flat scene."""
    ids = np.arange(len(scene), dtype=np.uint32) if scene.ids is None else scene.ids
    is_leaf = scene.tree.is_leaf
    if is_leaf.all():
        return dataclasses.replace(scene, ids=ids)
    flat = Scene.flat(scene.gaussians.take(is_leaf))
    return dataclasses.replace(
        scene, gaussians=flat.gaussians, tree=flat.tree, ids=ids[is_leaf], blocks=None, clusters=None
    )
