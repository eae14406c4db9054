"""Thin a scene that is larger than memory, by a radius: the file that thinning in memory writes, byte for byte.

The scene is cut into cells, as for a build. Each cell is thinned with what lies around it. What is left is put into the order of
the input again while it is written. A share or a count is met by the same search for a radius as in memory: each of its probes
counts what is left in every cell, without merging.
"""

import os
from collections.abc import Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from splatree.errors import InputError, OutputError
from splatree.io.formats.splatree.rows import open_scene
from splatree.io.objects import located
from splatree.io.options import ReadOptions, WriteOptions
from splatree.io.registry import FOLDER_FILE, format_to_write
from splatree.io.replacing import check_target
from splatree.io.writing import write_chunks
from splatree.lod.options import BuildOptions
from splatree.outofcore.cut import Cut, cut_into_cells, opened_inputs
from splatree.outofcore.load import num_within
from splatree.outofcore.options import FolderOptions, cell_bytes
from splatree.outofcore.plan import Plan
from splatree.outofcore.run import run_cells
from splatree.outofcore.work import Work, read_array
from splatree.scene.arguments import checked
from splatree.scene.gaussians import Gaussians
from splatree.scene.given import given
from splatree.scene.names import Mode
from splatree.scene.thinning import ThinOptions
from splatree.simplify.thin import radius_of_count

__all__ = ["ThinnedFile", "thin_file"]

ROWS_AT_ONCE = 1 << 16
"""Rows that are written at a time, about."""


@dataclass(frozen=True)
class ThinnedFile:
    """A scene that was thinned through files.

    Example:
        >>> thinned = st.thin_file("city.ply", "thin.ply", st.ThinOptions(radius=1.0), force=True)
        >>> thinned.num_read, thinned.num_written == len(st.read("thin.ply"))
        (253, True)
    """

    path: Path
    """The file."""
    num_read: int
    """Gaussians of the inputs."""
    num_written: int
    """Gaussians that are left."""
    radius: float
    """r, world units, as given or found."""
    options: ThinOptions
    """The rules that were followed, with method and merge rules filled in."""
    lost: tuple[str, ...] = ()
    """What of the inputs the file does not hold, a sentence each."""
    repairs: dict[str, int] = field(default_factory=dict)
    """How many values or rows each rule of repair touched."""
    notes: tuple[str, ...] = ()
    """What reading and thinning did that the user should know, a sentence each."""


@checked
def thin_file(
    inputs: str | os.PathLike[str] | Sequence[str | os.PathLike[str]],
    output: str | os.PathLike[str],
    options: ThinOptions | None = None,
    running: FolderOptions | None = None,
    *,
    reading: ReadOptions | None = None,
    mode: Mode | None = None,
    executor: Executor | None = None,
    force: bool = False,
) -> ThinnedFile:
    """Thin a scene that is larger than memory by a radius, and write it.

    The file is that of `thin` and `write`, byte for byte. A run that was interrupted goes on where it stopped if it is called
    again in the same way. Until it ends, its files are in a folder beside the output, with ``.work`` after its name.

    Args:
        inputs: one path or several of one scene, of formats that are read in chunks (`splatree formats`); of scenes with levels
            the leaves are taken.
        output: the new file, of a format that is written in chunks: .ply, .spz, .splat, .ksplat and others.
        options: a radius, or a share or count that is met by one; None: the automatic radius.
        running: memory and processes; None: half of the free memory and this process.
        reading: how the inputs are read.
        mode: how the scene is drawn, where the files do not say it.
        executor: as for `build_folder`.
        force: replace the file if it exists.

    Returns:
        What was written.

    Raises:
        FormatError: an input does not hold what it promises.
        InputError: an input or the output is not of a format that goes in chunks, pairs are asked for, or a radius reaches over
            more of the scene than the memory holds.
        OutputError: the output exists, could not be written, or is written by another process.
        MissingExtraError: a scheduler is named, and Dask is not installed.

    Source:
        docs/explanation/out-of-core.md.

    Example:
        >>> st.thin_file("city.ply", "thin.ply", st.ThinOptions(method="radius", keep=0.5), force=True).num_written
        127
    """
    options, reading = (
        given(options, ThinOptions, "thin_file: options"),
        given(reading, ReadOptions, "thin_file: reading"),
    )
    running = given(running, FolderOptions, "thin_file: running")
    if options.chosen_method != "radius":
        raise InputError(
            "method: found 'pairs' for thinning through files, wanted 'radius': pairs are chosen from the whole scene"
        )
    target = located(output)
    chosen = format_to_write(target)
    if chosen.write_chunks is None:
        raise InputError(f"{target}: format {chosen.name} is not written in chunks, wanted one that is, such as .ply")
    place = target.parent if target.name == FOLDER_FILE else target  # a folder of SOG
    check_target(target if place.is_dir() else place)
    if target.exists() and not force:
        raise OutputError(f"{target}: exists already; choose another name or replace it with force (--force)")
    work = Work.beside(place)
    with opened_inputs(inputs, reading, mode) as opened:
        options = replace(options, method="radius", merge=options.merge.resolved(opened.chunks.mode))
        decided = BuildOptions(
            method="radius",
            radius=options.radius if isinstance(options.radius, float | int) and options.radius > 0 else "auto",
            importance=options.importance,
            color_radius=options.color_radius,
            merge=options.merge,
            follow=False,
        )
        with cut_into_cells(work, opened, options, decided, running, reading=reading, executor=executor) as cut:
            radius = _radius(work, cut, options)
            _check_reach(work, cut, radius)
            results = run_cells(work, cut.plan, "thin", cut.workers, argument=radius)
            sizes = [result["rows"] for result in results]
            left = replace(
                opened.chunks, num_gaussians=sum(sizes), make=lambda: _rows(work, cut.plan, sizes), repairs={}
            )
            writing = WriteOptions(max_memory=running.max_memory)
            lost = write_chunks(left, target, force=force, options=writing)
            work.clear()
    return ThinnedFile(
        path=target,
        num_read=cut.plan.num_rows,
        num_written=sum(sizes),
        radius=radius,
        options=options,
        lost=lost,
        repairs=opened.repairs,
        notes=(*opened.notes, *cut.notes(running)),
    )


def _radius(work: Work, cut: Cut, options: ThinOptions) -> float:
    plan, wanted = cut.plan, options.count
    if options.keep is not None:
        wanted = max(1, round(options.keep * plan.num_rows))
    if wanted is None:
        return 0.0 if options.radius == 0 else plan.resolved.first_size

    def count(radius: float) -> int:
        _check_reach(work, cut, radius)
        return sum(result["rows"] for result in run_cells(work, plan, "count", cut.workers, argument=radius))

    color_radius = np.inf if options.color_radius is None else options.color_radius
    return radius_of_count(wanted, count, plan.num_rows, plan.resolved.first_size, plan.widest, color_radius)


def _check_reach(work: Work, cut: Cut, radius: float) -> None:
    """Refuse a radius for which more has to be loaded around a cell than fits."""
    for number in range(len(cut.plan.cells)):
        rows = num_within(work, cut.plan, number, radius)
        needed = cell_bytes(rows, (cut.plan.sh_degree + 1) ** 2)
        if rows > 2 * cut.plan.part_rows and needed > cut.room.piece_bytes:
            raise InputError(
                f"cell {number}: found {rows} Gaussians that a radius of {radius:.4g} reaches over, for which about "
                f"{needed // 10**6} MB are needed, wanted at most {cut.room.piece_bytes / 1e6:.0f} MB; raise --max-memory, or "
                "thin in two steps"
            )


def _rows(work: Work, plan: Plan, sizes: Sequence[int]) -> Iterator[Gaussians]:
    """What is left of all cells, in the order of the input."""
    cells = [number for number, size in enumerate(sizes) if size]
    step = max(1, plan.num_rows * ROWS_AT_ONCE // sum(sizes))
    scenes = [open_scene(work.thinned(number)) for number in cells]
    rows = [read_array(work.thinned_rows(number)) for number in cells]
    places = [0] * len(cells)
    for end in range(step, plan.num_rows + step, step):
        parts, inputs = [], []
        for i, (scene, of_cell) in enumerate(zip(scenes, rows, strict=True)):
            begin, places[i] = places[i], int(np.searchsorted(of_cell, end))
            if begin < places[i]:
                parts.append(scene.rows(begin, places[i]).gaussians)
                inputs.append(of_cell[begin : places[i]])
        if parts:
            yield Gaussians.concatenate(parts).take(np.argsort(np.concatenate(inputs)))
