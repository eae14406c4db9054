"""The fourth pass: the levels of one cell.

A cell is loaded with as much around it as growing needs, seven times the radii together; where that is too little, half as much
more, and again. Nothing is decided otherwise. What the cell owns is written as a part, and its roots again by themselves, for the
levels above.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from splatree.io.formats.folder.manifest import stored_file
from splatree.io.formats.splatree.rows import open_scene
from splatree.io.writing import write
from splatree.lod.assemble import assemble
from splatree.lod.forest import forest_of_leaves
from splatree.lod.grow_region import Owned, TooNarrowError, grow_region
from splatree.lod.region import Region
from splatree.outofcore.plan import Plan
from splatree.outofcore.shuffle import BOUND_ROWS
from splatree.outofcore.work import Work, read_array
from splatree.scene.gaussians import Gaussians
from splatree.scene.scene import Scene, Source
from splatree.scene.tree import GaussianTree
from splatree.shapes import Array, Int32, Int64

__all__ = ["grow_cell"]

FIRST_REACH = 7.0
"""How far around a cell is loaded at first, in sums of the radii of its levels: of 112 cells of a city none needed more."""

LONGER = 1.5
"""How much farther after growing found it too little."""


@dataclass(frozen=True, eq=False)
class _Loaded:
    """The rows of the whole scene within reach of a box."""

    gaussians: Gaussians
    """To degree 0."""
    inputs: Int64[Array, "n"]
    """Row of each in the input."""
    cells: Int32[Array, "n"]
    """The cell that each lies in."""
    rows: Int64[Array, "n"]
    """Its row there."""


def grow_cell(work: Work, plan: Plan, number: int, num_levels: int, threads: int = 0) -> dict[str, Any]:
    """Grow a cell and write its part; returns what the manifest and the report have to know."""
    owned, loaded = _grown(work, plan, number, num_levels, threads)
    result: dict[str, Any] = {"counts": owned.counts, "loaded": len(loaded.inputs), "leaves": len(owned.rows)}
    if not len(owned.rows):
        return {**result, "rows": 0, "roots": 0, "file": None}
    leaves = Scene.flat(_with_harmonics(work, plan, loaded, owned.rows), mode=plan.mode)
    del loaded
    part = assemble(owned.forest, leaves, plan.resolved, threads=threads)
    part = replace(part, blocks=None, source=Source())  # the crown has the provenance
    name = work.part_name(number)
    write(part, work.scene / name, force=True)
    rows = np.flatnonzero(part.tree.depth == 0)
    write(_roots_of(part, rows), work.roots(number), force=True)
    file = stored_file(work.scene, name)
    return {**result, "rows": len(part), "roots": len(rows), "depth": int(part.tree.depth.max()), "file": vars(file)}


def _grown(work: Work, plan: Plan, number: int, num_levels: int, threads: int) -> tuple[Owned, _Loaded]:
    box = plan.cells.boxes[number]
    radii = list(plan.resolved.sizes_from(0, num_levels))
    finite = [abs(side) for side in (*box.low, *box.high) if np.isfinite(side)]
    least = 1e-5 * max(finite, default=0.0)  # so that rounding is covered where radii are tiny
    reach = FIRST_REACH * sum(radii) + least if finite else np.inf
    while True:
        loaded = _load(work, plan, number, reach)
        scene = Scene.flat(loaded.gaussians, mode=plan.mode)
        forest = forest_of_leaves(scene, plan.resolved, inputs=loaded.inputs, threads=threads)
        try:
            region = Region(box, reach)
            return grow_region(forest, plan.resolved, region, num_levels=num_levels, threads=threads), loaded
        except TooNarrowError:
            reach *= LONGER


def _load(work: Work, plan: Plan, number: int, reach: float) -> _Loaded:
    box, parts = plan.cells.boxes[number], list[tuple[Gaussians, Array, Array, Array]]()
    for other in range(len(plan.cells)):
        bounds = read_array(work.bounds(other))
        near = np.flatnonzero(box.gaps(bounds[0], bounds[1]) <= reach)
        if not len(near):
            continue
        stored = open_scene(work.cell(other))
        for run in np.split(near, np.flatnonzero(np.diff(near) > 1) + 1):
            begin, end = int(run[0]) * BOUND_ROWS, min((int(run[-1]) + 1) * BOUND_ROWS, len(stored))
            rows = stored.rows(begin, end)
            assert rows.ids is not None
            kept = np.flatnonzero(box.distances(rows.gaussians.means) <= reach)
            cells = np.full(len(kept), other, np.int32)
            parts.append((rows.gaussians.take(kept), rows.ids[kept].astype(np.int64), cells, begin + kept))
    if not parts:
        nothing = np.empty(0, np.int64)
        return _Loaded(Gaussians.empty(), nothing, nothing.astype(np.int32), nothing)
    gaussians = Gaussians.concatenate([part[0] for part in parts])
    return _Loaded(gaussians, *(np.concatenate([part[i] for part in parts]) for i in (1, 2, 3)))


def _with_harmonics(work: Work, plan: Plan, loaded: _Loaded, rows: Array) -> Gaussians:
    """The loaded Gaussians in the order of ``rows``, with the harmonics of their cells."""
    leaves = loaded.gaussians.take(rows)
    if not plan.sh_degree:
        return leaves
    sh = np.empty((len(rows), (plan.sh_degree + 1) ** 2, 3), np.float32)
    sh[:, :1] = leaves.sh
    cells, places = loaded.cells[rows], loaded.rows[rows]
    for cell in np.unique(cells):
        of_cell = np.flatnonzero(cells == cell)
        sh[of_cell, 1:] = read_array(work.harmonics(int(cell)))[places[of_cell]]
    return replace(leaves, sh=sh)


def _roots_of(part: Scene, rows: Array) -> Scene:
    """The roots of a part as a flat scene which knows the state of growth."""
    end = np.arange(1, len(rows) + 1, dtype=np.int32)
    tree = GaussianTree(
        end, np.zeros(len(rows), np.uint8), part.tree.extents[rows], record=part.tree.record, roots=part.tree.roots
    )
    return Scene(part.gaussians.take(rows), tree, mode=part.mode)
