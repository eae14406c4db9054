"""The fourth pass: the levels of one cell.

By a radius, a cell is loaded with as much around it as growing needs, seven times the radii together; where that is too little,
half as much more, and again. Nothing is decided otherwise. By pairs, a cell is grown alone: what looks beyond its border waits,
and is merged where it meets its neighbours, by the levels above. What the cell owns is written as a part, and its roots again by
themselves, for the levels above.
"""

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np

from splatree.io.formats.folder.manifest import stored_file
from splatree.io.writing import write
from splatree.lod.assemble import assemble
from splatree.lod.forest import Forest, forest_of_leaves
from splatree.lod.grow_pairs import grow_by_pairs, grow_part_by_pairs
from splatree.lod.grow_region import Owned, TooNarrowError, grow_region
from splatree.lod.region import EVERYWHERE, Region
from splatree.outofcore.load import Loaded, load, load_alone, reaches, with_harmonics
from splatree.outofcore.plan import Plan
from splatree.outofcore.work import Work, read_array
from splatree.scene.scene import Scene, Source
from splatree.scene.tree import GaussianTree
from splatree.shapes import Array

__all__ = ["grow_cell", "grow_cell_by_pairs"]


FEWEST_SHARE = 16
"""Levels by pairs: a cell grows until one in so many of its rows is left, or waits at the border."""


def grow_cell(work: Work, plan: Plan, number: int, num_levels: int, threads: int = 0) -> dict[str, Any]:
    """Grow a cell by a radius and write its part; returns what the manifest and the report have to know."""
    owned, loaded = _grown(work, plan, number, num_levels, threads)
    result: dict[str, Any] = {"counts": owned.counts, "loaded": len(loaded.inputs)}
    return result | _write_part(work, plan, number, owned.forest, loaded, owned.rows, None, threads)


def grow_cell_by_pairs(work: Work, plan: Plan, number: int, num_levels: int, threads: int = 0) -> dict[str, Any]:
    """Grow a cell by pairs and write its part: as `grow_cell`, with no look at what is around it.

    Args:
        work: where the pieces are.
        plan: what was decided for the whole scene.
        number: of the cell.
        num_levels: sizes to go through; 0: until a sixteenth of the rows is left, or to the end if this is the only cell.
        threads: threads to use; 0: all.
    """
    loaded = load_alone(work, number)
    seen = read_array(work.seen)[loaded.inputs] if plan.sight is not None else np.ones(len(loaded.inputs), np.float32)
    scene = Scene.flat(loaded.gaussians, mode=plan.mode)
    leaves = forest_of_leaves(scene, plan.resolved, inputs=loaded.inputs, visibilities=seen, threads=threads)
    rows = leaves.base.order
    forest = replace(leaves, base=replace(leaves.base, order=np.arange(len(rows), dtype=np.int32)))
    box, levels = plan.cells.boxes[number], num_levels or None
    if box == EVERYWHERE:
        forest = grow_by_pairs(forest, plan.resolved, num_levels=levels, threads=threads)
    else:
        fewest = 1 if num_levels else len(rows) // FEWEST_SHARE
        forest = grow_part_by_pairs(forest, plan.resolved, box, num_levels=levels, fewest=fewest, threads=threads)
    merged = [[size, before - left] for size, (before, left) in zip(forest.sizes, pairwise(forest.counts), strict=True)]
    waiting = 0 if forest.grown is None else int((forest.grown < forest.num_sizes).sum())
    result: dict[str, Any] = {"merged": merged, "waiting": waiting}
    return result | _write_part(work, plan, number, forest, loaded, rows, leaves.visibilities, threads)


def _write_part(
    work: Work, plan: Plan, number: int, forest: Forest, loaded: Loaded, rows: Array, seen: Array | None, threads: int
) -> dict[str, Any]:
    """Write a part and its roots; ``seen`` of levels by pairs."""
    if not len(rows):
        return {"leaves": 0, "rows": 0, "roots": 0, "file": None}
    leaves = Scene.flat(with_harmonics(work, plan, loaded, rows), mode=plan.mode)
    part = assemble(forest, leaves, plan.resolved, seen=seen if plan.follows else None, threads=threads)
    part = replace(part, blocks=None, source=Source())  # the crown has the provenance
    if plan.follows and part.tree.curves is None:  # it has leaves alone
        part = replace(part, tree=replace(part.tree, curves=np.zeros((len(part), 4), np.float32)))
    name = work.part_name(number)
    write(part, work.scene / name, force=True)
    roots = _roots_of(part)
    if plan.follows:
        write(roots, work.drawn(number), force=True)
        roots = replace(roots, gaussians=replace(forest.present, sh=roots.gaussians.sh))  # as they were merged
    write(roots, work.roots(number), force=True)
    file = stored_file(work.scene, name)
    found = {"rows": len(part), "roots": len(forest.roots), "depth": int(part.tree.depth.max()), "file": vars(file)}
    return {"leaves": len(rows), **found}


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


def _roots_of(part: Scene) -> Scene:
    """The roots of a part as a flat scene which knows the state of growth."""
    rows = np.flatnonzero(part.tree.depth == 0)
    tree = GaussianTree(
        np.arange(1, len(rows) + 1, dtype=np.int32),
        np.zeros(len(rows), np.uint8),
        part.tree.extents[rows],
        curves=None if part.tree.curves is None else part.tree.curves[rows],
        record=part.tree.record,
        roots=part.tree.roots,
    )
    return Scene(part.gaussians.take(rows), tree, mode=part.mode)
