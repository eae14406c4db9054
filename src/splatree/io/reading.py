"""Read scenes of any format: one file, a folder, or several of them joined."""

import json
import os
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from splatree.errors import InputError, SplatreeError
from splatree.io.budget import RowBudget
from splatree.io.inputs import find_inputs
from splatree.io.joined import joined
from splatree.io.local import local_inputs
from splatree.io.memory import PROCESS_BYTES, free_bytes
from splatree.io.notes import with_notes
from splatree.io.options import ReadOptions, Repair
from splatree.io.registry import FORMATS, detect, files_of
from splatree.maths.axes import AxesName
from splatree.scene.arguments import checked
from splatree.scene.scene import Scene


@checked
def read(
    path: str | os.PathLike[str] | Sequence[str | os.PathLike[str]],
    *,
    level: int | None = None,
    repair: Repair = False,
    axes: AxesName | None = None,
    ignore_properties: bool = False,
) -> Scene:
    """Read one scene from a file, a folder, or several of them.

    A folder may be a format of its own (SOG, streamed SOG), the output of a training (its newest ``point_cloud/iteration_*`` is
    taken), or hold pieces of one scene: then every scene file and folder in it is read. Several inputs are joined in their order.
    If a single path matches no file but holds ``* ? [``, it is expanded as a pattern. Addresses (``https://…``), standard input
    (``-``), ``.gz`` and ``.zip`` of one file are read too.

    Args:
        path: one path or several.
        level: level of detail to take from a format that has several; 0, the default, is the finest.
        repair: repair or drop values that cannot be used, and count them in ``source.metadata["repairs"]``, instead of
            raising; "drop" drops every row that has one.
        axes: where x, y and z point in an .spz that does not say so; None: RDF, as in a .ply, or RUB for a thing that stands on
            y = 0.
        ignore_properties: read a .ply although it has properties that would change the picture (motion, other kernels);
            ``source.metadata["lost"]`` says which.

    Returns:
        The scene, with its levels if the format keeps them.

    Raises:
        FormatError: a file does not hold what it promises; the message says where and what to do.
        InputError: nothing is there, it is of no known format, or the inputs cannot be joined.

    Example:
        >>> st.read("city.ply").tree.num_levels
        1
        >>> len(st.read("chunk_*"))  # chunk_0, chunk_1
        253
    """
    options = ReadOptions(level, repair, axes, ignore_properties)
    with local_inputs(path) as local:
        inputs = find_inputs(local.paths, lambda p: detect(p) is not None)
        scene = joined(_within_budget(inputs.paths, options))
    source = replace(scene.source, paths=tuple(map(local.named, scene.source.paths)))
    return replace(scene, source=with_notes(source, inputs.notes))


def _within_budget(paths: Sequence[Path], options: ReadOptions) -> Iterator[Scene]:
    """The scenes of several files, as long as they are not more than the files can hold."""
    budget = RowBudget(f"{paths[0]} and {len(paths) - 1} more")
    for path in paths:
        scene = read_one(path, options)
        if len(paths) > 1:
            for file in files_of(path):
                budget.add_file(file)
            budget.take(len(scene))
        yield scene


@checked
def read_levels(path: str | os.PathLike[str], *, repair: bool = False) -> tuple[Scene, ...]:
    """Read all levels of a format that has several.

    Args:
        path: a file or folder, for instance a streamed SOG.
        repair: repair or drop values that cannot be used, and count them, instead of raising.

    Returns:
        The levels as flat scenes, the finest first. `link_levels` makes one tree of them.

    Raises:
        FormatError: a file does not hold what it promises.
        InputError: the format has no levels to choose from.

    Example:
        >>> fine, coarse = st.read_levels("playbot")
        >>> len(coarse) < len(fine)
        True
    """
    found = detect(Path(path))
    if found is None or found.holds.levels != "one of":
        name = "no known format" if found is None else f"format {found.name}"
        raise InputError(f"{path}: of {name}, which has no levels to choose from; wanted a folder with lod-meta.json")
    finest = read(path, repair=repair)
    num_levels = len(json.loads(finest.source.metadata["level_counts"]))
    return (finest, *(read(path, level=i, repair=repair) for i in range(1, num_levels)))


def read_one(path: Path, options: ReadOptions) -> Scene:
    """Read a file or folder that is a scene by itself, in whichever format."""
    found = detect(path)
    if found is None:
        raise InputError(f"{path}: of no known format; known are {', '.join(f.name for f in FORMATS)}")
    if options.level is not None and found.holds.levels != "one of":
        raise InputError(
            f"{path}: found level {options.level} for a file of format {found.name}, which has no levels to choose"
        )
    try:
        needed = needed_bytes(path)
        if needed is not None and needed > (free := free_bytes()):
            raise InputError(
                f"{path}: takes about {needed / 1e9:.1f} GB in memory, as a file of format {found.name} is read whole; found "
                f"{free / 1e9:.1f} GB free, wanted as much; convert it to .splatree on a machine with more memory"
            )
        scene = found.read(path, options)
    except OSError as error:
        if isinstance(error, SplatreeError):
            raise
        raise InputError(f"{path}: cannot be read ({error.strerror or error})") from error
    return replace(scene, source=replace(scene.source, paths=(str(path),), format=found.name))


def needed_bytes(path: Path) -> int | None:
    """Memory that reading a file takes, about, the program included; None: only reading it would tell."""
    found = detect(path)
    return None if found is None or found.whole_bytes is None else PROCESS_BYTES + found.whole_bytes(path)
