"""From inputs to cells: the first three passes, of a build and of a thinning.

What was asked for is kept with the plan, so that a second run of the same request goes on where the first one stopped.
"""

import os
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import Executor
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from splatree.errors import InputError, OutputError
from splatree.io.chunks import Chunks
from splatree.io.inputs import find_inputs
from splatree.io.joined_chunks import joined_chunks, opened_chunks
from splatree.io.local import local_inputs
from splatree.io.notes import notes_in
from splatree.io.options import ReadOptions
from splatree.io.registry import detect, files_of
from splatree.lod.options import BuildOptions
from splatree.lod.resolve import follows_pixels
from splatree.outofcore.cluster import cluster_at
from splatree.outofcore.fingerprint import fingerprint
from splatree.outofcore.lock import alone_in
from splatree.outofcore.options import PART_ROWS, FolderOptions, Room, cell_bytes
from splatree.outofcore.plan import Plan, make_plan, read_plan, request_of
from splatree.outofcore.run import Workers, run_cells
from splatree.outofcore.shuffle import cell_sizes, make_slices
from splatree.outofcore.work import Work
from splatree.scene.names import Mode
from splatree.scene.thinning import ThinOptions

__all__ = ["Cut", "Opened", "cut_into_cells", "errors_of_writing", "opened_inputs"]


@dataclass(frozen=True, eq=False)
class Opened:
    """Inputs that are read in chunks, as one scene."""

    chunks: Chunks
    """All rows."""
    parts: Sequence[Chunks]
    """Those of each input."""
    found: Sequence[Path]
    """The files and folders."""
    notes: tuple[str, ...]
    """What finding them did that the user should know, a sentence each."""

    @property
    def repairs(self) -> dict[str, int]:
        """How many values or rows each rule of repair touched, after a pass over the rows."""
        return dict(sum((Counter(part.repairs) for part in self.parts), Counter()))


@dataclass(frozen=True, eq=False)
class Cut:
    """A scene in cells, and who works on them."""

    plan: Plan
    """What was decided for the whole scene."""
    workers: Workers
    """Who does the pieces."""
    room: Room
    """How the memory is spent."""

    def notes(self, running: FolderOptions) -> tuple[str, ...]:
        """What the user should know, a sentence each."""
        kept = notes_in(self.plan.metadata, self.plan.origin)
        by_pairs = self.plan.resolved.method == "pairs"
        fit = self.plan.part_rows >= min(PART_ROWS, self.plan.num_rows)
        if running.part_rows is not None or fit or by_pairs:
            return kept
        return (
            *kept,
            f"cells have {self.plan.part_rows} Gaussians each, since memory is short; the result is the same",
        )


@contextmanager
def opened_inputs(
    inputs: str | os.PathLike[str] | Sequence[str | os.PathLike[str]], reading: ReadOptions, mode: Mode | None
) -> Iterator[Opened]:
    """One path or several as one scene in chunks, for as long as the context is open; of scenes with levels their leaves.

    Raises:
        InputError: an input is missing, or of a format that is not read in chunks.
    """
    with local_inputs(inputs) as local:
        found = find_inputs(local.paths, lambda path: detect(path) is not None)
        parts = opened_chunks(found.paths, reading, leaves=True)
        if parts is None:
            named = ", ".join(local.named(str(path)) for path in found.paths)
            raise InputError(f"{named}: found a format that is not read in chunks; convert it to .ply first")
        chunks = joined_chunks(parts, found.paths)
        kept = {key: text for key, text in chunks.metadata.items() if key not in ("levels", "clusters")}
        chunks = replace(chunks, mode=chunks.mode if mode is None else mode, metadata=kept)
        yield Opened(chunks, parts, found.paths, found.notes)


@contextmanager
def cut_into_cells(
    work: Work,
    opened: Opened,
    asked: BuildOptions | ThinOptions,
    options: BuildOptions,
    running: FolderOptions,
    *,
    reading: ReadOptions,
    executor: Executor | None,
) -> Iterator[Cut]:
    """Do the first three passes, or what of them was not done before.

    Args:
        work: where the pieces are.
        opened: the inputs.
        asked: the options of the verb: with the same ones, and the same inputs, a run goes on where it stopped.
        options: what is to be decided for the whole scene.
        running: memory, processes and the size of cells.
        reading: how the inputs are read.
        executor: runs the cells; None: as ``running`` says.

    Raises:
        InputError: a cell needs more memory than there is, or a cluster cannot take part.
        OutputError: something could not be written, or another process writes the same output.
    """
    if executor is not None and running.scheduler is not None:
        raise InputError(f"executor: found one beside the scheduler {running.scheduler}, wanted one of them")
    chunks = opened.chunks
    request = request_of([_identity(path) for path in opened.found], asked, running, reading, chunks.mode)
    with errors_of_writing(work), alone_in(work.folder):
        work.begin()
        try:
            with _runners(work, running, options, executor, chunks) as (workers, room):
                plan = _plan_to_go_on_with(work, request, room)
                if plan is None:
                    _clear(work)
                    plan = make_plan(work, chunks, options, request, room)
                make_slices(work, plan, chunks)
                _check_room(work, plan, room)
                run_cells(work, plan, "cell", workers)
                yield Cut(plan, workers, room)
        finally:
            if work.folder.exists() and not work.plan.exists():  # nothing to go on with
                work.clear()


@contextmanager
def _runners(
    work: Work, running: FolderOptions, options: BuildOptions, executor: Executor | None, chunks: Chunks
) -> Iterator[tuple[Workers, Room]]:
    """Who grows the cells, and how much memory there is for each."""
    room_of = partial(
        Room.of,
        running,
        len(chunks),
        (chunks.sh_degree + 1) ** 2,
        by_pairs=options.named_method == "pairs",
        follows=follows_pixels(options, chunks.mode),
    )
    if running.scheduler is None:
        room = room_of()
        yield Workers(room.workers, executor), room
        return
    with cluster_at(running.scheduler, work) as cluster:
        room = room_of(thread_bytes=cluster.thread_bytes)
        yield Workers(1, cluster.executor, cluster.died), room


def _plan_to_go_on_with(work: Work, request: dict[str, Any], room: Room) -> Plan | None:
    """The plan of an interrupted build of the same scene and bits, whose cells fit into the memory; None: there is none."""
    if not work.plan.exists():
        return None
    try:
        plan = read_plan(work)
    except InputError:
        return None  # of another version
    is_same = plan.request == request and plan.fingerprint == fingerprint()
    return plan if is_same and plan.part_rows <= room.part_rows else None


def _check_room(work: Work, plan: Plan, room: Room) -> None:
    """Refuse a cell that is too large for the memory and cannot be cut."""
    sizes = cell_sizes(work, plan)
    largest = int(sizes.argmax())
    by_pairs = plan.resolved.method == "pairs"
    needed = cell_bytes(int(sizes[largest]), (plan.sh_degree + 1) ** 2, by_pairs=by_pairs, follows=plan.follows)
    if sizes[largest] > 2 * plan.part_rows and needed > room.piece_bytes:
        raise InputError(
            f"cell {largest}: found {sizes[largest]} Gaussians so close together that they cannot be cut, for which about "
            f"{needed // 10**6} MB are needed, wanted at most {room.piece_bytes / 1e6:.0f} MB; raise --max-memory, or thin the "
            "scene"
        )


@contextmanager
def errors_of_writing(work: Work) -> Iterator[None]:
    """Say of errors of files which one it was, and that the work is not lost."""
    try:
        yield
    except OutputError:
        raise
    except OSError as error:
        raise OutputError(
            f"{error.filename or work.folder}: could not be read or written ({error.strerror or error}); run the command "
            "again to go on"
        ) from error


def _clear(work: Work) -> None:
    """Remove what another build left."""
    work.clear()
    work.begin()


def _identity(path: Path) -> dict[str, Any]:
    """By what an input is known to be the same when a build goes on."""
    return {
        str(file): [file.stat().st_size, file.stat().st_mtime_ns] for file in sorted(files_of(path)) if file.exists()
    }
