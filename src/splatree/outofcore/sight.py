"""The pass of levels by pairs: what others leave to be seen of each Gaussian, whatever fits into memory.

The scene is looked at along four axes, both ways (simplify/visibility.py). All rows go past a plane by their depth, so each axis
is a piece of work of its own: rows become splats in slabs of depth, and the slabs pass one after the other, there and back. On
the way there each slab is sorted, and kept so with what has been seen. What comes out has the bits of a measurement in memory. A
plane takes at most 32 bytes for each Gaussian of the scene, mostly far less.
"""

import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from splatree.errors import InputError
from splatree.io.formats.splatree.rows import open_scene
from splatree.io.replacing import replacing
from splatree.kernels.cpu.build.visibility import (
    NUM_AXES,
    SIGHTED,
    Plane,
    Sight,
    depths_along,
    plane_bytes,
    sighted_along,
    steps_of_depths,
    visibilities_from,
)
from splatree.outofcore.options import Room
from splatree.outofcore.plan import Plan
from splatree.outofcore.work import Work, new_array, read_array
from splatree.progress import task
from splatree.scene.gaussians import Gaussians
from splatree.shapes import Array
from splatree.simplify.visibility import SIZE_SAMPLES, as_counted, full_sight, relative, sample_of

__all__ = ["check_planes", "look_along", "write_seen"]

ROW = np.dtype([("key", "<u8"), ("splat", "<f4", len(SIGHTED))])
"""What passes of a Gaussian. The key is its step of depth and its row in the input: no two are the same, and sorting by one
number is eight times as fast as by two."""

NUM_BINS = 1 << 12
"""Steps of depth are counted in so many bins, of which slabs are put together."""

BIN_BITS = 10
"""Steps in a bin, as a power of two: there are 2²² steps."""

INPUT = np.uint64(2**32 - 1)
"""The bits of a key that are the row in the input."""

BATCH_ROWS = 1 << 20
"""Rows whose visibilities are written at a time."""


def check_planes(plan: Plan, room: Room) -> None:
    """Refuse planes that do not fit into memory beside a slab.

    Raises:
        InputError: they do not.
    """
    if plan.sight is not None and 2 * plane_bytes(plan.sight) > room.piece_bytes:
        raise InputError(
            f"visibility: found a plane of {plane_bytes(plan.sight) // 10**6} MB to look through, wanted at most half of "
            f"{room.piece_bytes / 1e6:.0f} MB; raise --max-memory, or leave it out with --no-visibility"
        )


def look_along(work: Work, plan: Plan, axis: int, argument: float = 0, threads: int = 0) -> dict[str, Any]:
    """Write what is seen of each row along an axis; leaves nothing to know."""
    assert plan.sight is not None
    folder = work.folder / "sight" / f"slabs-{axis}-{os.getpid()}"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    try:
        slabs = _write_slabs(work, plan, axis, folder, threads)
        _go_there(slabs, plan.sight)
        with replacing(work.sight(axis), force=True) as temporary:
            sums = new_array(temporary, plan.num_rows, np.dtype(np.float32))
            _come_back(slabs, plan.sight, sums)
            sums.flush()
            del sums
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    return {}


def _go_there(slabs: list[Path], sight: Sight) -> None:
    """Sort each slab, let it go past a plane, and keep it with what has been seen of it."""
    plane = Plane(sight, backwards=False)
    for path in slabs:
        rows = np.fromfile(path, ROW)
        rows = np.take(rows, np.argsort(rows["key"]))
        splats = np.ascontiguousarray(rows["splat"])
        plane.look_on(splats)
        rows["splat"] = splats
        rows.tofile(path)


def _come_back(slabs: list[Path], sight: Sight, sums: Array) -> None:
    """Let the slabs go past a plane the other way, and write the sums of both ways by the row in the input."""
    plane = Plane(sight, backwards=True)
    for path in reversed(slabs):
        rows = np.fromfile(path, ROW)
        splats = np.ascontiguousarray(rows["splat"])
        plane.look_on(splats)
        sums[(rows["key"] & INPUT).astype(np.int64)] = splats[:, -1]


def _write_slabs(work: Work, plan: Plan, axis: int, folder: Path, threads: int) -> list[Path]:
    """All rows in files by rising depth, each of about as many rows as a cell."""
    assert plan.sight is not None
    nearest, farthest = np.inf, -np.inf
    for cell, _ in _cells(work, plan):
        depths = depths_along(cell, plan.sight, axis, threads=threads)
        nearest, farthest = (
            min(nearest, float(depths.min(initial=np.inf))),
            max(farthest, float(depths.max(initial=-np.inf))),
        )
    counts = np.zeros(NUM_BINS, np.int64)
    for cell, _ in _cells(work, plan):
        depths = depths_along(cell, plan.sight, axis, threads=threads)
        counts += np.bincount(steps_of_depths(depths, nearest, farthest) >> BIN_BITS, minlength=NUM_BINS)
    slab_from_bin = (np.cumsum(counts) - counts) // plan.part_rows
    _, slab_from_bin = np.unique(slab_from_bin, return_inverse=True)
    paths = [folder / f"{slab:05}" for slab in range(slab_from_bin.max() + 1)]
    for cell, inputs in _cells(work, plan):
        step = steps_of_depths(depths_along(cell, plan.sight, axis, threads=threads), nearest, farthest)
        rows = np.empty(len(cell), ROW)
        rows["key"] = step.astype(np.uint64) << np.uint64(32) | inputs
        rows["splat"] = sighted_along(cell, plan.sight, axis, threads=threads)
        slab = slab_from_bin[step >> BIN_BITS]
        order = np.argsort(slab, kind="stable")
        start = np.searchsorted(slab[order], np.arange(len(paths) + 1))
        for number in np.flatnonzero(np.diff(start)):
            with paths[number].open("ab") as file:
                np.take(rows, order[start[number] : start[number + 1]]).tofile(file)
    return [path for path in paths if path.exists()]


def _cells(work: Work, plan: Plan) -> Iterator[tuple[Gaussians, Array]]:
    """The Gaussians of each cell to degree 0, and their rows in the input."""
    for number in range(len(plan.cells)):
        stored = open_scene(work.cell(number))
        rows = stored.rows(0, len(stored))
        assert rows.ids is not None
        yield rows.gaussians, rows.ids


def write_seen(work: Work, plan: Plan) -> None:
    """Put what is seen along all axes together, once for the whole scene."""
    if work.result("seen", plan.run) is not None:
        return
    along = [read_array(work.sight(axis)) for axis in range(NUM_AXES)]
    sample = visibilities_from(np.stack([sample_of(sums, SIZE_SAMPLES) for sums in along]))
    full = full_sight(sample)
    with (
        task("put together what is seen", float(plan.num_rows)) as advance,
        replacing(work.seen, force=True) as temporary,
    ):
        seen = new_array(temporary, plan.num_rows, np.dtype(np.float32))
        for begin in range(0, plan.num_rows, BATCH_ROWS):
            batch = visibilities_from(np.stack([sums[begin : begin + BATCH_ROWS] for sums in along]))
            seen[begin : begin + BATCH_ROWS] = as_counted(plan.mode, relative(batch, full))
            advance(float(len(batch)))
        seen.flush()
        del seen
    work.finish("seen", plan.run, {})
