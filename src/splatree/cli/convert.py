"""``splatree convert``: a scene in another format, moved, cropped or filtered on the way."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

from tyro.conf import arg

from splatree.cli.comparison import Reporting, in_words, read_back
from splatree.cli.console import Console, UsageError, counted, size
from splatree.cli.files import Files, inputs_and_output, read_scene, told
from splatree.edit.edit import edit
from splatree.edit.options import EditOptions
from splatree.errors import InputError
from splatree.io.convert import ConvertOptions, convert
from splatree.io.formats.spz.versions import DEFAULT_VERSION, readers_of
from splatree.io.options import ReadOptions, Repair, WriteOptions
from splatree.io.registry import format_to_write, stored_bytes
from splatree.render.compare_page import Comparison
from splatree.scene.names import Mode


@dataclass(frozen=True)
class Command:
    """Write a scene in another format, which the suffix of the output names; edit it on the way.

    Edits are done in this order: --drop-invalid, --min-opacity, --scale, --rotate, --translate, --crop-box, --crop-sphere,
    --sh-degree, --order. Files larger than memory are converted in chunks where both formats allow it (see `formats`).
    """

    files: Annotated[Files, arg(name="", help="")]
    level: int | None = None
    """Level of detail to read from a format that has several; 0 is the finest."""
    depth: int | None = None
    """Write one cut of the tree to a format without levels: the nodes at this depth, 0 the roots; None: the leaves."""
    mode: Mode | None = None
    """How the scene was trained and is drawn, where the file does not say it. None: as the file says, else `classic`."""
    drop_invalid: bool = False
    """Drop Gaussians with values that cannot be used, and count them, instead of stopping; --repair mends what it can."""
    edit: Annotated[EditOptions, arg(name="", help="")] = EditOptions()
    options: Annotated[WriteOptions, arg(name="", help="")] = WriteOptions()
    reporting: Annotated[Reporting, arg(name="", help="")] = Reporting()
    console: Annotated[Console, arg(name="", help="")] = Console()


@dataclass(frozen=True)
class Result:
    """What was written."""

    output: Path
    """The file."""
    num_read: int
    """Gaussians read, without merged ones."""
    num_gaussians: int
    """Gaussians written, without merged ones; with a depth, nodes of the cut."""
    depth: int | None
    """Depth of the cut that was asked for."""
    bytes: int
    """Size of the file; of a folder of SOG, of all files that its meta.json names."""
    repairs: dict[str, int]
    """How many values or rows each rule of repair touched."""
    lost: tuple[str, ...]
    """What of the inputs the file does not hold, a sentence each."""
    in_chunks: bool
    """Whether it went in chunks, with bounded memory."""
    notes: tuple[str, ...] = ()
    """What reading did that the user should know, a sentence each."""
    version: str | None = None
    """Version of .spz that was written, who reads it and who does not; None for other formats."""
    comparison: Comparison | None = None
    """What was lost in pictures, if --report asks for it."""


def run(command: Command) -> Result:
    """Read, edit, write."""
    inputs, output = inputs_and_output(command.files, options=command.options)
    reading = command.files.reading
    repair: Repair = "drop" if command.drop_invalid else reading.repair
    read = ReadOptions(command.level, repair, reading.input_axes, reading.ignore_properties)
    try:
        options = ConvertOptions(read, command.edit, command.options, command.depth, command.mode)
    except InputError as error:
        raise UsageError(str(error)) from error
    command.reporting.check(force=command.files.force)
    done = convert(inputs, output, options, force=command.files.force)
    return Result(
        output=output,
        num_read=done.num_read,
        num_gaussians=done.num_written,
        depth=command.depth,
        bytes=stored_bytes(output),
        repairs=done.repairs,
        lost=done.lost,
        in_chunks=done.in_chunks,
        notes=done.notes,
        version=_version(output, command.options),
        comparison=_comparison(command, inputs, output),
    )


def _version(output: Path, options: WriteOptions) -> str | None:
    if format_to_write(output).name != "spz":
        return None
    return readers_of(DEFAULT_VERSION if options.format_version is None else options.format_version)


def _comparison(command: Command, inputs: Sequence[Path], output: Path) -> Comparison | None:
    """What was written beside what was read, moved as the edits say; what filters dropped counts as lost."""
    if command.reporting.report is None:
        return None
    edits = command.edit
    move = EditOptions(scale=edits.scale, rotate=edits.rotate, translate=edits.translate)
    reference = edit(read_scene(inputs, command.files.reading, level=command.level), move)
    if command.mode is not None:
        reference = replace(reference, mode=command.mode)
    made_from = ", ".join(map(str, inputs))
    return read_back(output, reference, command.reporting, made_from=made_from, force=command.files.force)


def show(result: Result) -> str:
    """The result in words."""
    of = f"{result.num_gaussians:,} of " if result.num_read != result.num_gaussians else ""
    if result.depth is not None:
        of = f"{counted(result.num_gaussians, 'node')} at depth {result.depth} for "
    wrote = f"wrote {result.output}: {of}{counted(result.num_read, 'Gaussian')}, {size(result.bytes)}"
    version = [] if result.version is None else [result.version]
    compared = [] if result.comparison is None else in_words(result.comparison)
    return "\n".join([wrote, *version, *told(result.repairs, result.lost, result.notes), *compared])
