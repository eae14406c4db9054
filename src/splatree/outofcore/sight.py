"""The pass that measures what others leave to be seen of each Gaussian, whatever fits into memory.

The scene is looked at along four axes, both ways (simplify/visibility.py). All rows go past a plane by their depth, so each axis
is a piece of work of its own: rows become splats, are sorted, and pass there and back. Where they do not fit into memory
together, they lie in slabs of depth, which pass one after the other. On the way there each slab is sorted, and kept so with what
has been seen; the last one stays for the way back. What comes out has the bits of a measurement in memory. A plane takes at most
32 bytes for each Gaussian of the scene, mostly far less.
"""

import os
import shutil
from collections.abc import Iterator
from dataclasses import dataclass
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
from splatree.outofcore.options import Room, row_bytes_of
from splatree.outofcore.plan import Plan
from splatree.outofcore.work import Work, new_array, read_array
from splatree.progress import task
from splatree.scene.gaussians import Gaussians
from splatree.shapes import Array, Float32, UInt64
from splatree.simplify.visibility import SIZE_SAMPLES, as_counted, full_sight, relative, sample_of

__all__ = ["check_planes", "look_along", "write_seen"]

SLAB_ROW_BYTES = 112
"""What a row of a slab takes while it is sorted: its key and its splat, their order, and both in that order."""

NUM_BINS = 1 << 12
"""Steps of depth are counted in so many bins, of which slabs are put together."""

BIN_BITS = 10
"""Steps in a bin, as a power of two: there are 2²² steps."""

INPUT = np.uint64(2**32 - 1)
"""The bits of a key that are the row in the input."""

BATCH_ROWS = 1 << 20
"""Rows whose visibilities are written at a time."""


@dataclass(frozen=True, eq=False)
class _Slab:
    """Rows that go past a plane together."""

    keys: UInt64[Array, "n"]
    """The step of depth of each, and its row in the input: no two are the same, and sorting by one number is eight times as fast
    as by two."""
    splats: Float32[Array, "n 10"]
    """The rows as they are seen (`SIGHTED`)."""

    @staticmethod
    def read(path: Path) -> "_Slab":
        """What was put into files."""
        splats = np.fromfile(path.with_suffix(".splats"), np.float32)
        return _Slab(np.fromfile(path.with_suffix(".keys"), np.uint64), splats.reshape(-1, len(SIGHTED)))

    def write(self, path: Path, mode: str = "wb") -> None:
        """Put all into files."""
        for name, column in (("keys", self.keys), ("splats", self.splats)):
            with path.with_suffix(f".{name}").open(mode) as file:
                column.tofile(file)

    def take(self, rows: Array) -> "_Slab":
        """Some of the rows."""
        return _Slab(self.keys[rows], np.take(self.splats, rows, axis=0))


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
        fits = plan.num_rows <= _slab_rows(plan, plan.sight)
        paths = [] if fits else _write_slabs(work, plan, plan.sight, axis, folder, threads)
        slab = _all_rows(work, plan, plan.sight, axis, threads) if fits else None
        with replacing(work.sight(axis), force=True) as temporary:
            sums = new_array(temporary, plan.num_rows, np.dtype(np.float32))
            _come_back(paths, _go_there(paths, slab, plan.sight), plan.sight, sums)
            sums.flush()
            del sums
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    return {}


def _slab_rows(plan: Plan, sight: Sight) -> int:
    """Rows of a slab that takes no more memory with its plane than growing a cell."""
    by_pairs = plan.resolved.method == "pairs"
    cell = plan.part_rows * row_bytes_of((plan.sh_degree + 1) ** 2, by_pairs=by_pairs, follows=plan.follows)
    return max(plan.part_rows, (cell - plane_bytes(sight)) // SLAB_ROW_BYTES)


def _go_there(paths: list[Path], slab: _Slab | None, sight: Sight) -> _Slab:
    """Sort each slab, let it go past a plane, and keep it with what has been seen of it; returns the last one.

    Args:
        paths: the slabs; none where ``slab`` has all rows.
    """
    plane = Plane(sight, backwards=False)
    each: list[Path | None] = [*paths] or [None]
    for path in each:
        if path is not None:
            slab = None  # before the next one is read
            slab = _Slab.read(path)
        assert slab is not None
        slab = slab.take(np.argsort(slab.keys))
        plane.look_on(slab.splats)
        if path is not None and path is not paths[-1]:
            slab.write(path)
    assert slab is not None
    return slab


def _come_back(paths: list[Path], slab: _Slab | None, sight: Sight, sums: Array) -> None:
    """Let the slabs, the last one first, go past a plane the other way, and write the sums of both ways by row."""
    plane = Plane(sight, backwards=True)
    for path in (None, *reversed(paths[:-1])):
        if path is not None:
            slab = None  # before the next one is read
            slab = _Slab.read(path)
        assert slab is not None
        plane.look_on(slab.splats)
        sums[(slab.keys & INPUT).astype(np.int64)] = slab.splats[:, -1]


def _all_rows(work: Work, plan: Plan, sight: Sight, axis: int, threads: int) -> _Slab:
    """All rows as one slab."""
    keys, splats = np.empty(plan.num_rows, np.uint64), np.empty((plan.num_rows, len(SIGHTED)), np.float32)
    begin = 0
    for cell, inputs in _cells(work, plan):
        rows = slice(begin, begin + len(cell))
        keys[rows], splats[rows] = inputs, sighted_along(cell, sight, axis, threads=threads)
        begin = rows.stop
    depths = np.ascontiguousarray(splats[:, SIGHTED.index("depth")])
    keys |= _high(steps_of_depths(depths, float(depths.min()), float(depths.max())))
    return _Slab(keys, splats)


def _write_slabs(work: Work, plan: Plan, sight: Sight, axis: int, folder: Path, threads: int) -> list[Path]:
    """All rows in files by rising depth."""
    nearest, farthest = np.inf, -np.inf
    for depths in _depths(work, plan, sight, axis, threads):
        nearest = min(nearest, float(depths.min(initial=np.inf)))
        farthest = max(farthest, float(depths.max(initial=-np.inf)))
    counts = np.zeros(NUM_BINS, np.int64)
    for depths in _depths(work, plan, sight, axis, threads):
        counts += np.bincount(steps_of_depths(depths, nearest, farthest) >> BIN_BITS, minlength=NUM_BINS)
    slab_from_bin = (np.cumsum(counts) - counts) // _slab_rows(plan, sight)
    _, slab_from_bin = np.unique(slab_from_bin, return_inverse=True)
    paths = [folder / f"{slab:05}" for slab in range(slab_from_bin.max() + 1)]
    is_begun = np.zeros(len(paths), bool)
    for cell, inputs in _cells(work, plan):
        step = steps_of_depths(depths_along(cell.means, sight, axis, threads=threads), nearest, farthest)
        rows = _Slab(_high(step) | inputs, sighted_along(cell, sight, axis, threads=threads))
        slab = slab_from_bin[step >> BIN_BITS]
        order = np.argsort(slab, kind="stable")
        start = np.searchsorted(slab[order], np.arange(len(paths) + 1))
        for number in np.flatnonzero(np.diff(start)):
            rows.take(order[start[number] : start[number + 1]]).write(paths[number], "ab")
            is_begun[number] = True
    return [path for path, begun in zip(paths, is_begun, strict=True) if begun]


def _high(steps: Array) -> UInt64[Array, "n"]:
    """Steps of depth where a key has them."""
    return np.asarray(steps.astype(np.uint64) << np.uint64(32))


def _depths(work: Work, plan: Plan, sight: Sight, axis: int, threads: int) -> Iterator[Array]:
    """The depths of each cell along an axis."""
    for number in range(len(plan.cells)):
        yield depths_along(open_scene(work.cell(number)).file.rows("gaussians.means"), sight, axis, threads=threads)


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
