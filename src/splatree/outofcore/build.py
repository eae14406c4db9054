"""Build levels of detail over a scene that is larger than memory.

Five passes, each through files: a plan, slices of the input by cell, cells along the curve, the levels of each cell, the levels
above. The tree is that of `build_lod`, bit for bit, however the scene was cut: docs/explanation/out-of-core.md.
"""

import os
import shutil
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import Executor
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from splatree.errors import InputError, OutputError
from splatree.io.chunks import Chunks
from splatree.io.formats.folder.manifest import MANIFEST, Manifest, is_manifest, total_bytes
from splatree.io.inputs import find_inputs
from splatree.io.joined_chunks import joined_chunks, opened_chunks
from splatree.io.local import local_inputs
from splatree.io.notes import notes_in
from splatree.io.options import ReadOptions
from splatree.io.registry import detect, files_of
from splatree.lod.options import BuildOptions
from splatree.outofcore.options import MOST_LEVELS, PART_ROWS, FolderOptions, Room, cell_bytes, top_bytes
from splatree.outofcore.plan import Plan, make_plan, read_plan, request_of
from splatree.outofcore.run import Workers, run_cells
from splatree.outofcore.shuffle import cell_sizes, make_slices
from splatree.outofcore.top import finish_scene
from splatree.outofcore.work import Work
from splatree.scene.names import Mode
from splatree.scene.scene import Source

__all__ = ["BuiltFolder", "build_folder"]

UNTRIED = "levels are by a radius, as all that are built through files: pairs are chosen from the whole scene in memory"
"""Said unless the method was named."""


@dataclass(frozen=True)
class BuiltFolder:
    """A scene that was built through files.

    Example:
        >>> built = st.build_folder("city.ply", "parts.splatree")
        >>> built.num_gaussians, built.num_parts
        (253, 1)
    """

    path: Path
    """The folder."""
    num_gaussians: int
    """Leaves."""
    num_nodes: int
    """Leaves and merged nodes."""
    num_parts: int
    """Files of whole subtrees."""
    bytes: int
    """Size of all files."""
    rules: dict[str, Any]
    """Radii, and nodes left after each level, and the rules, as they are written into the folder."""
    repairs: dict[str, int] = field(default_factory=dict)
    """How many values or rows each rule of repair touched."""
    notes: tuple[str, ...] = ()
    """What reading and building did that the user should know, a sentence each."""


def build_folder(
    inputs: str | os.PathLike[str] | Sequence[str | os.PathLike[str]],
    output: str | os.PathLike[str],
    options: BuildOptions | None = None,
    running: FolderOptions | None = None,
    *,
    reading: ReadOptions | None = None,
    mode: Mode | None = None,
    executor: Executor | None = None,
    force: bool = False,
) -> BuiltFolder:
    """Build levels of detail over a scene that is larger than memory, and write a folder of parts.

    The tree is that of `build_lod` with ``follow=False``, bit for bit, but for the identities of merged nodes. A build that was
    interrupted goes on where it stopped if it is called again in the same way. Until it ends, its files are in a folder beside
    the output, with ``.work`` after its name.

    Args:
        inputs: one path or several of one scene, of formats that are read in chunks: .ply, .spz, .splat, .sog, .ksplat.
        output: the new folder.
        options: how levels grow; the method `auto` is a radius here. None: the defaults.
        running: memory, processes and the size of parts; None: half of the free memory and this process.
        reading: how the inputs are read.
        mode: how the scene is drawn, where the files do not say it.
        executor: runs the cells, in any process that sees the files of the output and the folder beside it, and that runs this
            version on a processor of the same kind; None: ``running.workers`` processes of this machine.
        force: replace the folder if it exists.

    Returns:
        What was written.

    Raises:
        FormatError: an input does not hold what it promises.
        InputError: an input is not read in chunks, an option does not suit, or a cell needs more memory than there is.
        OutputError: the output exists, or could not be written.

    Source:
        docs/explanation/out-of-core.md.

    Example:
        >>> built = st.build_folder("city.ply", "city_parts.splatree")
        >>> len(st.read("city_parts.splatree")) == built.num_nodes
        True
    """
    options, running, reading = options or BuildOptions(), running or FolderOptions(), reading or ReadOptions()
    if options.only_method == "pairs":
        raise InputError(
            "method: found 'pairs', or options of pairs, for a build through files, wanted 'radius': pairs are chosen from the "
            "whole scene"
        )
    untried = options.only_method is None
    options = replace(options, method="radius")
    target = _target(Path(output), force)
    paths = [inputs] if isinstance(inputs, str | os.PathLike) else list(inputs)
    work = Work(target.with_name(target.name + ".work"))
    with local_inputs([Path(path) for path in paths]) as local:
        found = find_inputs(local.paths, lambda path: detect(path) is not None)
        parts = opened_chunks(found.paths, reading)
        if parts is None:
            raise InputError(
                f"{', '.join(map(str, paths))}: found a format that is not read in chunks; convert it to .ply first"
            )
        chunks = joined_chunks(parts, found.paths)
        if mode is not None:
            chunks = replace(chunks, mode=mode)
        with _errors_of_writing(work):
            work.begin()
            request = request_of([_identity(path) for path in found.paths], options, running, reading, chunks.mode)
            plan, manifest, report = _built(work, chunks, options, running, request, executor)
            _take_place(work, target, force)
    return BuiltFolder(
        path=Path(output),
        num_gaussians=manifest.num_leaves,
        num_nodes=manifest.num_rows,
        num_parts=len(manifest.parts),
        bytes=total_bytes([manifest.crown, *manifest.parts]),
        rules=report,
        repairs=dict(sum((Counter(part.repairs) for part in parts), Counter())),
        notes=(
            *found.notes,
            *notes_in(plan.metadata, plan.origin),
            *((UNTRIED,) if untried else ()),
            *_note_on_parts(plan, running),
            *_note_on_pixels(plan, options),
        ),
    )


def _built(
    work: Work,
    chunks: Chunks,
    options: BuildOptions,
    running: FolderOptions,
    request: dict[str, Any],
    executor: Executor | None,
) -> tuple[Plan, Manifest, dict[str, Any]]:
    room = Room.of(running, (chunks.sh_degree + 1) ** 2)
    threads = 0 if room.workers == 1 and executor is None else 1
    plan = _plan_to_go_on_with(work, request, room)
    if plan is None:
        _clear(work)
        plan = make_plan(work, chunks, options, request, room)
    make_slices(work, plan, chunks)
    _check_room(work, plan, room)
    workers = Workers(room.workers, executor)
    run_cells(work, plan, "cell", workers, threads=threads)
    num_levels = running.part_levels
    while True:
        results = run_cells(work, plan, "grow", workers, num_levels=num_levels, threads=threads)
        left = [sum(counts) for counts in zip(*(result["counts"] for result in results), strict=True)]
        # A build in memory ends where few enough are left: parts may not have grown beyond that.
        ended = [level for level, num_left in enumerate(left[:-1]) if num_left <= plan.resolved.max_roots]
        if ended:
            num_levels = ended[0]
        elif top_bytes(left[-1], (plan.sh_degree + 1) ** 2) <= room.max_bytes:
            break
        elif num_levels < MOST_LEVELS:  # fewer nodes are left after one level more
            num_levels += 1
        else:
            raise InputError(
                f"build: found {left[-1]} nodes that are left after {num_levels} levels, which do not fit in "
                f"{room.max_bytes // 10**6} MB at once; raise --max-memory"
            )
    source = Source(metadata=plan.metadata, origin=plan.origin)
    return plan, *finish_scene(work, plan, results, source)


def _plan_to_go_on_with(work: Work, request: dict[str, Any], room: Room) -> Plan | None:
    """The plan of an interrupted build of the same scene, whose cells fit into the memory; None: there is none."""
    if not work.plan.exists():
        return None
    try:
        plan = read_plan(work)
    except InputError:
        return None  # of another version
    return plan if plan.request == request and plan.part_rows <= room.part_rows else None


def _check_room(work: Work, plan: Plan, room: Room) -> None:
    """Refuse a cell that is too large for the memory and cannot be cut."""
    sizes = cell_sizes(work, plan)
    largest = int(sizes.argmax())
    needed = cell_bytes(int(sizes[largest]), (plan.sh_degree + 1) ** 2)
    if sizes[largest] > 2 * plan.part_rows and needed > room.max_bytes:
        raise InputError(
            f"cell {largest}: found {sizes[largest]} Gaussians so close together that they cannot be cut, for which about "
            f"{needed // 10**6} MB are needed, wanted at most {room.max_bytes // 10**6} MB; raise --max-memory, or thin the scene"
        )


def _target(output: Path, force: bool) -> Path:
    try:
        target = output.resolve()
        if not target.parent.is_dir():
            raise OutputError(f"{output}: cannot be written, there is no folder {target.parent}")
        if target.exists() and not force:
            raise OutputError(f"{output}: exists already; choose another name or replace it with force")
        if target.exists() and not (target.is_dir() and (is_manifest(target / MANIFEST) or not any(target.iterdir()))):
            raise OutputError(f"{output}: cannot be replaced, it is not the folder of a scene; choose another name")
    except RuntimeError as error:
        raise OutputError(f"{output}: cannot be written, its links lead in a circle") from error
    return target


@contextmanager
def _errors_of_writing(work: Work) -> Iterator[None]:
    try:
        yield
    except OutputError:
        raise
    except OSError as error:
        raise OutputError(
            f"{error.filename or work.folder}: could not be read or written ({error.strerror or error}); run the build again "
            "to go on"
        ) from error


def _note_on_parts(plan: Plan, running: FolderOptions) -> tuple[str, ...]:
    if running.part_rows is not None or plan.part_rows == PART_ROWS:
        return ()
    return (
        f"parts are cut for {plan.part_rows} Gaussians each, since memory is short: other files, but the same tree",
    )


def _note_on_pixels(plan: Plan, options: BuildOptions) -> tuple[str, ...]:
    if not options.follow or plan.mode != "classic":
        return ()
    return (
        "merged Gaussians are drawn as stored, as after --no-follow: how they follow pixels is fitted to the whole scene in "
        "memory",
    )


def _clear(work: Work) -> None:
    """Remove what another build left."""
    shutil.rmtree(work.folder, ignore_errors=True)
    work.begin()


def _take_place(work: Work, target: Path, force: bool) -> None:
    """Move the finished folder to its name, and remove the rest."""
    work.plan.unlink()  # from here on, another build begins anew
    old = work.folder / "old"
    if target.exists() and force:
        target.rename(old)
    work.scene.rename(target)
    shutil.rmtree(work.folder, ignore_errors=True)


def _identity(path: Path) -> dict[str, Any]:
    """By what an input is known to be the same when a build goes on."""
    return {
        str(file): [file.stat().st_size, file.stat().st_mtime_ns] for file in sorted(files_of(path)) if file.exists()
    }
