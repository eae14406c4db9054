"""From a file's nodes to a scene with levels: check the values, bound the subtrees, index the blocks."""

import json
from dataclasses import dataclass, replace

import numpy as np

from splatree.errors import FormatError, InputError
from splatree.io.check import checked
from splatree.io.options import Repair
from splatree.kernels.cpu.frame.blocks import index_blocks
from splatree.maths.forests import Preorder, preorder_from_links, subtree_radii
from splatree.scene.gaussians import Gaussians
from splatree.scene.levels import UNKNOWN_LEVELS, LevelRecord
from splatree.scene.names import Mode
from splatree.scene.scene import Scene, Source
from splatree.scene.tree import GaussianTree
from splatree.shapes import Array, Float32, Int32, UInt8

__all__ = ["FileLevels", "check_extents", "preorder_of_file", "scene_with_levels"]


def preorder_of_file(first_child: Array, num_children: Array, roots: Array, where: str) -> Preorder:
    """As `preorder_from_links`, with errors that name the file."""
    try:
        return preorder_from_links(first_child, num_children, roots)
    except InputError as error:
        raise FormatError(f"{where}: {error}") from error


@dataclass(frozen=True, eq=False)
class FileLevels:
    """What a file says of its tree, rows in preorder."""

    subtree_end: Int32[Array, "n"]
    """One past the last row of the subtree of each row."""
    depth: UInt8[Array, "n"]
    """Edges from the root."""
    record: LevelRecord = UNKNOWN_LEVELS
    """How the levels were made."""
    extents: Float32[Array, "n"] | None = None
    """Extents of the inner rows; None: they are balls around what is below."""


def scene_with_levels(
    gaussians: Gaussians,
    levels: FileLevels,
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
    if not levels.depth.any():
        return checked(Scene.flat(gaussians, mode=mode, source=source), where, repair=repair)
    given = np.zeros(len(gaussians), np.float32) if levels.extents is None else levels.extents
    unbounded = GaussianTree(levels.subtree_end, levels.depth, given, record=levels.record)
    scene = checked(Scene(gaussians, unbounded, mode=mode, source=source), where, repair=repair)
    if levels.extents is None:
        extents = subtree_radii(gaussians.means, gaussians.reach(), levels.depth)
    else:
        check_extents(given, where)
        largest = np.finfo(np.float32).max
        own = np.nextafter(np.minimum(gaussians.reach(), largest).astype(np.float32), largest)
        extents = np.where(unbounded.is_leaf, own, given)
    tree = replace(unbounded, extents=extents)
    return replace(scene, tree=tree, blocks=index_blocks(gaussians, tree))


def check_extents(extents: Float32[Array, "n"], where: str, *, first_row: int = 0) -> None:
    """Refuse extents that the selection cannot use.

    Raises:
        FormatError: names the first row.
    """
    usable = np.isfinite(extents) & (extents >= 0)
    if not usable.all():
        row = int(np.argmin(usable))
        raise FormatError(
            f"{where}: row {first_row + row}, tree.extents: found {extents[row]}, wanted 0 or more; build the levels again"
        )
