"""One level of a scene as a flat scene, for formats without levels."""

from dataclasses import replace

import numpy as np

from splatree.errors import InputError
from splatree.scene.scene import Scene


def level_of(scene: Scene, level: int) -> Scene:
    """One level of a scene as a flat scene: 0 are the leaves, each next one is a step nearer to the roots.

    Raises:
        InputError: the scene has no such level.
    """
    num_levels = scene.tree.num_levels
    if not 0 <= level < num_levels:
        wanted = "0, as it has one level" if num_levels == 1 else f"0 (the finest) to {num_levels - 1}"
        raise InputError(f"level: found {level}, wanted {wanted}; `splatree build` makes levels")
    return cut_at(scene, None if level == 0 else num_levels - 1 - level)


def cut_at(scene: Scene, depth: int | None) -> Scene:
    """The leaves, or the nodes at a depth and the leaves above it, as a flat scene."""
    if depth is not None and depth < 0:
        raise InputError(f"write: found depth {depth}, wanted 0 (the roots) or more")
    drawn = scene.tree.is_leaf
    if depth is not None:
        drawn = (drawn & (scene.tree.depth < depth)) | (scene.tree.depth == depth)
    if drawn.all():
        return scene
    flat = Scene.flat(scene.gaussians.take(np.flatnonzero(drawn)), mode=scene.mode, source=scene.source)
    return replace(flat, threshold=scene.threshold, tile_rule=scene.tile_rule)
