"""Other columns in the rows of a scene: what has to be made anew then, and what can stay."""

from collections.abc import Mapping
from dataclasses import fields, replace

from splatree.errors import InputError, ShapeError
from splatree.kernels.cpu.build.spheres import bound_clusters
from splatree.kernels.cpu.frame.blocks import index_blocks
from splatree.scene.gaussians import Gaussians
from splatree.scene.scene import Scene
from splatree.shapes import Array

__all__ = ["updated_scene"]

INDEXED = ("means", "log_scales", "logit_opacities")
"""Columns that the index of the blocks bounds."""
BOUNDED = ("means", "quats", "log_scales", "logit_opacities")
"""Columns that spheres and boxes of clusters bound."""


def updated_scene(
    scene: Scene, columns: Gaussians | Mapping[str, Array], *, keep_index: bool, threads: int
) -> tuple[Scene, tuple[str, ...]]:
    """The scene with other columns, and the names of those; without blocks and clusters if the index is kept.

    Raises:
        InputError: a name is unknown, or the index of a tree with levels shall be kept.
        ShapeError: a column has another number of rows or another type.
    """
    known = tuple(field.name for field in fields(Gaussians))
    new = {name: getattr(columns, name) for name in known} if isinstance(columns, Gaussians) else dict(columns)
    unknown = sorted(set(new) - set(known))
    if unknown:
        raise InputError(f"update: found column {unknown[0]!r}, wanted some of {', '.join(known)}")
    for name, column in new.items():
        shape = getattr(scene.gaussians, name).shape
        if column.shape != shape:
            raise ShapeError(
                f"update: {name}: found shape {column.shape}, wanted {shape}; for another number of rows open another session"
            )
    gaussians = replace(scene.gaussians, **new)
    names = tuple(name for name in known if name in new)
    if keep_index:
        if scene.tree.num_levels > 1:
            raise InputError("update: found keep_index for a tree with levels, wanted it for a scene without")
        return replace(scene, gaussians=gaussians, blocks=None, clusters=None), names
    blocks, clusters = scene.blocks, scene.clusters
    if blocks is None or not set(INDEXED).isdisjoint(names):
        blocks = index_blocks(gaussians, scene.tree, threads=threads)
    if clusters is not None and not set(BOUNDED).isdisjoint(names):
        clusters = bound_clusters(gaussians, clusters.start, clusters.centers)
    return replace(scene, gaussians=gaussians, blocks=blocks, clusters=clusters), names
