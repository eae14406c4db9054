"""From a file's nodes to a scene with levels: check the values, bound the subtrees, index the blocks."""

import json
from dataclasses import replace

import numpy as np

from splatree.errors import FormatError, InputError
from splatree.io.check import checked
from splatree.io.options import Repair
from splatree.kernels.cpu.frame.blocks import index_blocks
from splatree.maths.forests import Preorder, preorder_from_links, subtree_radii
from splatree.scene.gaussians import Gaussians
from splatree.scene.scene import Mode, Scene, Source
from splatree.scene.tree import GaussianTree
from splatree.shapes import Array

__all__ = ["preorder_of_file", "scene_with_levels"]


def preorder_of_file(first_child: Array, num_children: Array, roots: Array, where: str) -> Preorder:
    """As `preorder_from_links`, with errors that name the file."""
    try:
        return preorder_from_links(first_child, num_children, roots)
    except InputError as error:
        raise FormatError(f"{where}: {error}") from error


def scene_with_levels(
    gaussians: Gaussians,
    subtree_end: Array,
    depth: Array,
    where: str,
    *,
    repair: Repair,
    num_opaque: int,
    mode: Mode = "classic",
) -> Scene:
    """A scene whose rows are in preorder; without levels if all rows are leaves.

    ``num_opaque`` counts the Gaussians of opacity above 1 that were read as wider ones (`splatree.io.opacities`).

    Raises:
        FormatError: a value cannot be used.
    """
    metadata = {"opacities_above_one": json.dumps({"read_as_wider": num_opaque})} if num_opaque else {}
    source = Source(metadata=metadata)
    if not depth.any():
        return checked(Scene.flat(gaussians, mode=mode, source=source), where, repair=repair)
    unbounded = GaussianTree(subtree_end, depth, np.zeros(len(depth), np.float32))
    scene = checked(Scene(gaussians, unbounded, mode=mode, source=source), where, repair=repair)
    tree = replace(unbounded, extents=subtree_radii(gaussians.means, gaussians.reach(), depth))
    return replace(scene, tree=tree, blocks=index_blocks(gaussians, tree))
