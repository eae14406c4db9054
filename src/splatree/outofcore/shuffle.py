"""The second and the third pass: rows of the input to slices by cell, then each cell along the Morton curve.

A slice is some consecutive rows of the input, sorted by cell, with a table of where each cell begins. A cell takes its runs from
all slices in their order, so rows of equal Morton code stand in the order of the input. It has the bounds of each 2,048 rows and
no harmonics above degree 0, since its neighbours do not ask for them. These stay in the slices until a part is written.
"""

from dataclasses import replace
from typing import Any

import numpy as np

from splatree.errors import InputError
from splatree.io.chunks import Chunks
from splatree.io.formats.splatree.head import SceneHead
from splatree.io.formats.splatree.rows import open_scene
from splatree.io.formats.splatree.writer import create_scene
from splatree.io.rows import regrouped
from splatree.maths.morton import morton_codes
from splatree.outofcore.plan import Plan
from splatree.outofcore.work import Work, write_array
from splatree.progress import task
from splatree.scene.gaussians import Gaussians
from splatree.scene.scene import Scene
from splatree.shapes import Array, Float32, Int32, Int64

__all__ = ["BOUND_ROWS", "harmonics_of", "make_cell", "make_slices", "write_bounds"]

BOUND_ROWS = 2048
"""Rows of a cell that share a box of bounds."""

BATCH_ROWS = 1 << 16
"""Rows that are written at a time."""


def make_slices(work: Work, plan: Plan, chunks: Chunks) -> None:
    """Write the slices that are not there yet."""
    with task("sort into cells", float(plan.num_rows)) as advance:
        for number, rows in enumerate(regrouped(chunks, min(plan.slice_rows, plan.num_rows), plan.sh_degree)):
            if work.result(f"slice-{number:05}", plan.run) is None:
                _make_slice(work, plan, number, rows)
            advance(float(len(rows)))


def _make_slice(work: Work, plan: Plan, number: int, gaussians: Gaussians) -> None:
    cells = plan.cells.of(gaussians.means)
    order = np.argsort(cells, kind="stable")
    start = np.searchsorted(cells[order], np.arange(len(plan.cells) + 1))
    head = SceneHead(len(gaussians), plan.sh_degree, plan.mode, has_ids=True)
    first = number * plan.slice_rows
    with create_scene(work.slice(number), head, force=True) as writer:
        for begin in range(0, len(order), BATCH_ROWS):
            rows = order[begin : begin + BATCH_ROWS]
            writer.append(replace(Scene.flat(gaussians.take(rows)), ids=(first + rows).astype(np.uint32)))
    work.finish(f"slice-{number:05}", plan.run, {"start": start.tolist()})


def cell_sizes(work: Work, plan: Plan) -> Array:
    """How many rows each cell has."""
    return np.asarray(np.sum([np.diff(_start(work, plan, number)) for number in range(plan.num_slices)], axis=0))


def _start(work: Work, plan: Plan, number: int) -> Array:
    result = work.result(f"slice-{number:05}", plan.run)
    if result is None:
        raise InputError(f"{work.slice(number)}: is not done; run the build again")
    return np.asarray(result["start"])


def make_cell(work: Work, plan: Plan, number: int, argument: float = 0, threads: int = 0) -> dict[str, Any]:
    """Write a cell: its rows along the curve. It needs neither an argument nor threads, and leaves nothing to know."""
    parts, ids = [], []
    for source in range(plan.num_slices):
        start = _start(work, plan, source)
        if start[number] < start[number + 1]:
            rows = open_scene(work.slice(source)).rows(int(start[number]), int(start[number + 1]), harmonics=False)
            parts.append(rows.gaussians.with_sh_degree(0))
            assert rows.ids is not None
            ids.append(rows.ids)
    gaussians = Gaussians.concatenate(parts)
    inputs = np.concatenate(ids) if ids else np.empty(0, np.uint32)
    order = np.argsort(morton_codes(gaussians.means, plan.resolved.frame), kind="stable")
    head = SceneHead(len(order), 0, plan.mode, has_ids=True)
    with create_scene(work.cell(number), head, force=True) as writer:
        for begin in range(0, len(order), BATCH_ROWS):
            batch = order[begin : begin + BATCH_ROWS]
            writer.append(replace(Scene.flat(gaussians.take(batch)), ids=inputs[batch]))
    write_bounds(work, number, gaussians.means[order])
    return {}


def harmonics_of(
    work: Work, plan: Plan, inputs: Int64[Array, "n"], cells: Int32[Array, "n"]
) -> Float32[Array, "n k 3"]:
    """All harmonics of rows of the input, from the slices; ``cells`` are those that they lie in."""
    sh = np.empty((len(inputs), (plan.sh_degree + 1) ** 2, 3), np.float32)
    sources = inputs // plan.slice_rows
    for source in np.unique(sources):
        start, file = _start(work, plan, int(source)), open_scene(work.slice(int(source))).file
        of_slice = np.flatnonzero(sources == source)
        for cell in np.unique(cells[of_slice]):
            here = of_slice[cells[of_slice] == cell]
            run = int(start[cell]), int(start[cell + 1])
            places = np.searchsorted(file.rows("ids", *run), inputs[here])  # ids ascend in the run of a cell
            sh[here] = np.take(file.rows("gaussians.sh", *run), places, axis=0)
    return sh


def write_bounds(work: Work, number: int, means: Array) -> None:
    """Write the boxes of each 2,048 rows of a cell."""
    start = np.arange(0, len(means), BOUND_ROWS)
    bounds = (
        np.stack([f.reduceat(means, start, axis=0) for f in (np.minimum, np.maximum)])
        if len(start)
        else np.empty((2, 0, 3))
    )
    write_array(work.bounds(number), bounds.astype(np.float64))
