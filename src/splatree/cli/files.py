"""Inputs and outputs of a verb: ``verb in.ply out.ply``, or ``verb chunk_*/ -o out.ply`` for several inputs."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from splatree.cli.console import UsageError
from splatree.errors import InputError, OutputError
from splatree.io.inputs import find_inputs
from splatree.io.local import is_brought
from splatree.io.notes import notes_in, repairs_in, repairs_in_words, sentences_in
from splatree.io.objects import located
from splatree.io.options import ReadOptions, WriteOptions
from splatree.io.reading import read
from splatree.io.registry import FOLDER_FILE, Format, detect, format_to_write, formats
from splatree.io.replacing import check_target
from splatree.maths.axes import AxesName
from splatree.scene import modes
from splatree.scene.names import Mode
from splatree.scene.scene import Scene


@dataclass(frozen=True)
class Reading:
    """How inputs are taken."""

    repair: bool = False
    """Fix or drop values that cannot be used, and count them, instead of stopping."""
    input_axes: AxesName | None = None
    """Where x, y, z point in an .spz that does not say it: left or right, up or down, front or back. None: RDF, as
    in a .ply, or RUB for a thing that stands on y = 0."""
    ignore_properties: bool = False
    """Read a .ply whose other properties change the picture (motion, other kernels) without them, and say what is lost."""


@dataclass(frozen=True)
class Files:
    """What a verb reads and writes."""

    paths: Positional[tuple[Path, ...]]
    """Inputs, and last the output unless it is named with -o; several inputs are read as one scene."""
    output: Annotated[Path | None, arg(aliases=["-o"])] = None
    """File to write."""
    force: bool = False
    """Replace the output if it exists."""
    reading: Annotated[Reading, arg(name="", help="")] = Reading()


def check_inputs(paths: tuple[Path, ...]) -> None:
    """Refuse a verb that only reads, without anything to read.

    Raises:
        UsageError: there is no path.
    """
    if not paths:
        raise UsageError("found no path, wanted a scene: a file or a folder, or several which are one scene")


def read_scene(paths: Sequence[Path], reading: Reading, *, level: int | None = None) -> Scene:
    """One scene from all paths."""
    return read(
        paths,
        level=level,
        repair=reading.repair,
        axes=reading.input_axes,
        ignore_properties=reading.ignore_properties,
    )


def read_options(reading: Reading, *, level: int | None = None) -> ReadOptions:
    """The options of the library's readers."""
    return ReadOptions(level, reading.repair, reading.input_axes, reading.ignore_properties)


def repairs_of(scene: Scene) -> dict[str, int]:
    """How many values or rows each rule of repair touched when the scene was read."""
    return repairs_in(scene.source.metadata)


def lost_and_noted(scene: Scene, lost: Sequence[str] = ()) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """What reading and writing a scene lost, and what the reader noted, a sentence each."""
    metadata = scene.source.metadata
    both = dict.fromkeys((*sentences_in(metadata, "lost"), *lost))
    return tuple(both), notes_in(metadata, scene.source.origin)


def in_mode(scene: Scene, mode: Mode | None) -> Scene:
    """The scene, drawn in another mode.

    Raises:
        UsageError: it has levels of detail, which were made for its own mode.
    """
    try:
        return modes.in_mode(scene, mode)
    except InputError as error:
        raise UsageError(str(error)) from error


def told(repairs: Mapping[str, int], lost: Sequence[str], notes: Sequence[str] = ()) -> list[str]:
    """What reading changed and noted, and what reading and writing lost, a line each."""
    lines = [f"repaired: {repairs_in_words(repairs)}"] if repairs else []
    return [*lines, *(f"note: {note}" for note in notes), *(f"lost: {sentence}" for sentence in lost)]


def inputs_and_output(
    named: Files, *, keeps_tree: bool = False, options: WriteOptions | None = None
) -> tuple[tuple[Path, ...], Path]:
    """The inputs, and the output: named with ``-o``, or else the last path; checked before any work is done.

    Raises:
        UsageError: there is no input, or no output, or an output that is also read; or its suffix is of no format that is
            written, or of one that does not take the options, or, where the tree has to be kept, of one without levels.
        OutputError: the output exists and ``--force`` is not given, or no file can be written there.
    """
    inputs, output = _divided(named, "out.splatree" if keeps_tree else "out.ply")
    if named.output is None and output.is_dir():
        # `build chunk_*/` without -o: the last chunk is an input, surely.
        raise UsageError(f"{output}: is a folder, wanted a file to write; name the output with -o")
    # A folder of SOG is made, if only it has where to stand.
    check_target(output.parent if output.name == FOLDER_FILE and not output.parent.is_dir() else output)
    if output.exists() and any(path.samefile(output) for path in _files_read(inputs, deeply=named.force)):
        raise UsageError(f"{output}: is an input too; choose another name for the output")
    chosen = output_format(output, keeps_tree=keeps_tree)
    try:
        (options or WriteOptions()).check_taken(chosen.options, f"{output} ({chosen.name})")
    except InputError as error:
        raise UsageError(str(error)) from error
    if output.exists() and not named.force:
        raise OutputError(f"{output}: exists already; choose another name or replace it with --force")
    return inputs, output


def output_format(output: Path, *, keeps_tree: bool) -> Format:
    """The format that an output's name ends in.

    Raises:
        UsageError: there is none, or the tree has to be kept and it has no levels.
    """
    try:
        chosen = format_to_write(output)
        if not keeps_tree or chosen.holds.levels == "tree":
            return chosen
        found = f"format {chosen.name} has no levels of detail"
    except InputError as error:
        if not keeps_tree:
            raise UsageError(str(error)) from error
        found = f"its suffix is {output.suffix!r}"
    *suffixes, last = [suffix for f in formats() if f.is_written and f.holds.levels == "tree" for suffix in f.suffixes]
    raise UsageError(
        f"{output}: {found}, wanted {', '.join(suffixes)} or {last}, as in {output.stem}.splatree; folders for viewers on the "
        "web are made of that file by splatree stream"
    )


def _files_read(inputs: Sequence[Path], *, deeply: bool) -> list[Path]:
    """The inputs that are there, and ``deeply`` the files that folders and patterns among them stand for."""
    there = [path for path in inputs if path.exists()]
    at_hand = [path for path in inputs if deeply and str(path) != "-" and not is_brought(path)]
    return there + (find_inputs(at_hand, lambda path: detect(path) is not None).paths if at_hand else [])


def inputs_and_folder(named: Files) -> tuple[tuple[Path, ...], Path]:
    """As `inputs_and_output`, where the output is a folder of parts, ``city.splatree``.

    Raises:
        UsageError: there is no input, or no output, or its name does not end in .splatree, or it is also read.
    """
    inputs, output = _divided(named, "out.splatree")
    if output.suffix != ".splatree":
        raise UsageError(
            f"{output}: through files (--max-memory, --workers, --scheduler, the size of parts) a folder of parts is written, "
            f"wanted a name that ends in .splatree, such as {output.with_suffix('.splatree')}"
        )
    if any(path.exists() and output.exists() and path.samefile(output) for path in inputs):
        raise UsageError(f"{output}: is an input too; choose another name for the output")
    return inputs, output


def _divided(named: Files, example: str) -> tuple[tuple[Path, ...], Path]:
    """The inputs and the output, of which neither may be missing; errors name the output like ``example``."""
    inputs, output = named.paths, named.output
    if output is None:
        if len(inputs) < 2:
            found = "one path" if inputs else "no path"
            raise UsageError(
                f"found {found}, wanted an input and an output: in.ply {example}, or chunk_*/ -o {example}"
            )
        *sources, output = inputs
        inputs = tuple(sources)
    inputs, output = tuple(map(located, inputs)), located(output)
    if not inputs:
        raise UsageError(f"found no input, wanted at least one: in.ply {example}, or chunk_*/ -o {example}")
    return inputs, output
