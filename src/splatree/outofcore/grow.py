"""The fourth pass: the levels of one cell.

A cell is loaded with as much around it as growing needs, seven times the radii together; where that is too little, half as much
more, and again. Nothing is decided otherwise. What the cell owns is written as a part, and its roots again by themselves, for the
levels above.
"""

from dataclasses import replace
from typing import Any

import numpy as np

from splatree.io.formats.folder.manifest import stored_file
from splatree.io.writing import write
from splatree.lod.assemble import assemble
from splatree.lod.forest import forest_of_leaves
from splatree.lod.grow_region import Owned, TooNarrowError, grow_region
from splatree.lod.region import Region
from splatree.outofcore.load import Loaded, load, reaches, with_harmonics
from splatree.outofcore.plan import Plan
from splatree.outofcore.work import Work
from splatree.scene.scene import Scene, Source
from splatree.scene.tree import GaussianTree
from splatree.shapes import Array

__all__ = ["grow_cell"]


def grow_cell(work: Work, plan: Plan, number: int, num_levels: int, threads: int = 0) -> dict[str, Any]:
    """Grow a cell and write its part; returns what the manifest and the report have to know."""
    owned, loaded = _grown(work, plan, number, num_levels, threads)
    result: dict[str, Any] = {"counts": owned.counts, "loaded": len(loaded.inputs), "leaves": len(owned.rows)}
    if not len(owned.rows):
        return {**result, "rows": 0, "roots": 0, "file": None}
    leaves = Scene.flat(with_harmonics(work, plan, loaded, owned.rows), mode=plan.mode)
    del loaded
    part = assemble(owned.forest, leaves, plan.resolved, threads=threads)
    part = replace(part, blocks=None, source=Source())  # the crown has the provenance
    name = work.part_name(number)
    write(part, work.scene / name, force=True)
    rows = np.flatnonzero(part.tree.depth == 0)
    write(_roots_of(part, rows), work.roots(number), force=True)
    file = stored_file(work.scene, name)
    return {**result, "rows": len(part), "roots": len(rows), "depth": int(part.tree.depth.max()), "file": vars(file)}


def _grown(work: Work, plan: Plan, number: int, num_levels: int, threads: int) -> tuple[Owned, Loaded]:
    box = plan.cells.boxes[number]
    radii = plan.resolved.sizes_from(0, num_levels)
    for reach in reaches(box, sum(radii)):
        loaded = load(work, plan, number, reach)
        scene = Scene.flat(loaded.gaussians, mode=plan.mode)
        forest = forest_of_leaves(scene, plan.resolved, inputs=loaded.inputs, threads=threads)
        try:
            region = Region(box, reach)
            return grow_region(forest, plan.resolved, region, num_levels=num_levels, threads=threads), loaded
        except TooNarrowError:
            continue
    raise AssertionError("reaches end")


def _roots_of(part: Scene, rows: Array) -> Scene:
    """The roots of a part as a flat scene which knows the state of growth."""
    end = np.arange(1, len(rows) + 1, dtype=np.int32)
    tree = GaussianTree(
        end, np.zeros(len(rows), np.uint8), part.tree.extents[rows], record=part.tree.record, roots=part.tree.roots
    )
    return Scene(part.gaussians.take(rows), tree, mode=part.mode)
