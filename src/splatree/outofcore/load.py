"""Load a cell and what lies around it."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from splatree.io.formats.splatree.rows import open_scene
from splatree.lod.region import Box
from splatree.outofcore.plan import Plan
from splatree.outofcore.shuffle import BOUND_ROWS, harmonics_of
from splatree.outofcore.work import Work, read_array
from splatree.scene.gaussians import Gaussians
from splatree.scene.roots import Roots
from splatree.shapes import Array, Float32, Int32, Int64

__all__ = ["Loaded", "harmonics", "load", "num_within", "reaches"]

FIRST_REACH = 7.0
"""How far around a cell is loaded at first, in sums of the radii of its levels: of 112 cells of a city none needed more."""

LONGER = 1.5
"""How much farther after growing found it too little."""


@dataclass(frozen=True, eq=False)
class Loaded:
    """The rows of the whole scene within reach of a box."""

    gaussians: Gaussians
    """To degree 0."""
    inputs: Int64[Array, "n"]
    """Row of each in the input; above parts, its number among the roots of all parts."""
    cells: Int32[Array, "n"]
    """The cell that each lies in; above parts, the part whose root it is."""
    rows: Int64[Array, "n"]
    """Its row there."""
    roots: Roots | None
    """Above parts, the state of growth of each."""

    def take(self, rows: Array) -> "Loaded":
        """Some of the rows."""
        roots = None if self.roots is None else self.roots.take(rows)
        return Loaded(self.gaussians.take(rows), self.inputs[rows], self.cells[rows], self.rows[rows], roots)


def reaches(box: Box, radii: float) -> Iterator[float]:
    """How far around a box to load, world units, for radii of that sum: at first, and each time that it was too little."""
    finite = [abs(side) for side in (*box.low, *box.high) if np.isfinite(side)]
    if not finite:
        yield np.inf  # the box is everything
    reach = FIRST_REACH * radii + 1e-5 * max(finite, default=0.0)  # so that rounding is covered where radii are tiny
    while True:
        yield reach
        reach = max(reach * LONGER, 1e-30)


def num_within(work: Work, plan: Plan, number: int, radii: float) -> int:
    """How many rows `load` goes through for a cell at first, or a few more."""
    box, count = plan.cells.boxes[number], 0
    reach = next(reaches(box, radii))
    for other in range(len(plan.cells)):
        bounds = read_array(work.bounds(other))
        count += BOUND_ROWS * int((box.gaps(bounds[0], bounds[1]) <= reach).sum())
    return count


def load(work: Work, plan: Plan, number: int, reach: float) -> Loaded:
    """All rows of the scene whose mean is within a distance of the box of a cell."""
    box, parts, states = plan.cells.boxes[number], list[tuple[Gaussians, Array, Array, Array]](), list[Roots]()
    for other in range(plan.num_files):
        bounds = read_array(work.bounds(other))
        near = np.flatnonzero(box.gaps(bounds[0], bounds[1]) <= reach)
        if not len(near):
            continue
        stored = open_scene(work.cell(other))
        for run in np.split(near, np.flatnonzero(np.diff(near) > 1) + 1):
            begin, end = int(run[0]) * BOUND_ROWS, min((int(run[-1]) + 1) * BOUND_ROWS, len(stored))
            rows = stored.rows(begin, end)
            kept = np.flatnonzero(box.distances(rows.gaussians.means) <= reach)
            if plan.first_roots is not None:
                inputs = plan.first_roots[other] + begin + kept
                assert stored.head.roots is not None
                states.append(stored.head.roots.take(begin + kept))
            else:
                assert rows.ids is not None
                inputs = rows.ids[kept].astype(np.int64)
            parts.append((rows.gaussians.take(kept), inputs, np.full(len(kept), other, np.int32), begin + kept))
    if not parts:
        nothing = np.empty(0, np.int64)
        return Loaded(Gaussians.empty(), nothing, nothing.astype(np.int32), nothing, None)
    gaussians = Gaussians.concatenate([part[0] for part in parts])
    inputs, cells, rows_there = (np.concatenate([part[i] for part in parts]) for i in (1, 2, 3))
    return Loaded(gaussians, inputs, cells, rows_there, Roots.concatenate(states) if states else None)


def harmonics(work: Work, plan: Plan, loaded: Loaded, rows: Array) -> Float32[Array, "m k 3"]:
    """All harmonics of some of the loaded rows, in a new array."""
    if not plan.sh_degree:
        return np.take(loaded.gaussians.sh, rows, axis=0)
    cells = loaded.cells[rows]
    if plan.first_roots is None:
        return harmonics_of(work, plan, loaded.inputs[rows], cells)
    sh = np.empty((len(rows), (plan.sh_degree + 1) ** 2, 3), np.float32)
    sh[:, :1] = loaded.gaussians.sh[rows]
    for part in np.unique(cells):
        of_part = np.flatnonzero(cells == part)
        sh[of_part, 1:] = np.take(read_array(work.harmonics(int(part))), loaded.rows[rows[of_part]], axis=0)
    return sh
