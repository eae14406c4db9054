"""``splatree stream``: a scene as viewers on the web load it, piece by piece."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from splatree.cli.console import Console, UsageError, counted, size, table
from splatree.cli.files import Reading, in_mode, lost_and_noted, read_scene, repairs_of, told
from splatree.errors import InputError
from splatree.io.cameras.files import read_cameras
from splatree.io.formats.folder.manifest import holds_parts
from splatree.io.inputs import check_are_there
from splatree.io.memory import give_back_freed
from splatree.io.notes import origin_in_words
from splatree.io.replacing import check_target, replacing
from splatree.io.tree_runs import stored_runs
from splatree.outofcore.mapped import mapped_whole
from splatree.scene.names import Mode
from splatree.scene.scene import Scene
from splatree.stream.options import StreamFormat, StreamOptions
from splatree.stream.report import StreamReport, ViewQuality, report_stream
from splatree.stream.report_page import write_stream_report
from splatree.stream.result import LevelWritten, Streamed
from splatree.stream.stream import check_output, of_degree, scratch_beside, stream, with_levels


@dataclass(frozen=True)
class Command:
    """Write a stream that viewers on the web load piece by piece, finer where the camera is near.

    `sog` is a folder for PlayCanvas, SuperSplat and Babylon.js, `rad` a file for Spark, `3dtiles` a folder for
    CesiumJS. A scene without levels of detail gets
    them first. A command that was interrupted goes on where it stopped when it is given again.

    Example: splatree stream city.splatree city_stream; then splatree serve city_stream
    """

    paths: Positional[tuple[Path, ...]]
    """Inputs, and last the output unless it is named with -o; several inputs are read as one scene."""
    output: Annotated[Path | None, arg(aliases=["-o"])] = None
    """Folder (sog, 3dtiles) or file (rad) to write."""
    format: StreamFormat = "sog"
    """Who reads it: sog for PlayCanvas, SuperSplat and Babylon.js; rad for Spark; 3dtiles for CesiumJS."""
    force: bool = False
    """Replace an older stream."""
    report: Path | None = None
    """Write a report: the quality of the picture against the bytes that a viewer loads for it, near, middle and far, and of
    each level and chunk. A page with a chart and a picture of the worst view if the name ends in .html, else JSON."""
    cameras: Path | None = None
    """Views of the report, in place of near, middle and far: a file of cameras."""
    mode: Mode | None = None
    """How a scene without levels of detail was trained and is drawn; None: as the file says, else `classic`."""
    max_memory: str | None = None
    """Most memory for a folder of parts or an exact .splatree, such as 4G: what needs more waits in files beside the output, and
    the stream is the same. None: half of what is free."""
    reading: Annotated[Reading, arg(name="", help="")] = Reading()
    options: Annotated[StreamOptions, arg(name="", help="")] = StreamOptions()
    console: Annotated[Console, arg(name="", help="")] = Console()


@dataclass(frozen=True)
class Result:
    """What was written."""

    written: Streamed
    """The stream."""
    built_levels: bool
    """Whether the levels of detail were made first."""
    repairs: dict[str, int]
    """How many values or rows each rule of repair touched."""
    lost: tuple[str, ...] = ()
    """What of the inputs the stream does not hold, a sentence each."""
    notes: tuple[str, ...] = ()
    """What reading did that the user should know, a sentence each."""
    report: StreamReport | None = None
    """The quality of the stream, if it was asked for."""


def run(command: Command) -> Result:
    """Read, build levels where there are none, write."""
    inputs, output = _inputs_and_output(command)
    try:
        command.options.check_used(command.format)
    except InputError as error:
        raise UsageError(str(error)) from error
    if command.cameras is not None and command.report is None:
        raise UsageError("--cameras: are the views of a report; name its file with --report")
    check_output(output, command.format, command.options, force=command.force)
    if command.max_memory is not None:
        scratch_beside(output, command.max_memory)  # refuses what is no memory
        _check_is_mapped(inputs, command.max_memory)
    if command.report is not None:
        check_target(command.report)
    give_back_freed()
    with _scene(command, inputs, output) as read:
        return _streamed(command, in_mode(read, command.mode), output)


def _check_is_mapped(inputs: tuple[Path, ...], max_memory: str) -> None:
    """Refuse a limit of memory for a scene that is read whole."""
    tree = stored_runs(inputs[0]) if len(inputs) == 1 and inputs[0].exists() else None
    if tree is None or tree.head.source.format not in _MAPPED or tree.num_leaves == len(tree):
        check_are_there(inputs)
        raise UsageError(
            f"found --max-memory for {', '.join(map(str, inputs))}, but only a folder of parts and an exact .splatree with "
            f"levels are not read whole; build the levels through files first: splatree build {' '.join(map(str, inputs))} "
            f"-o parts.splatree --max-memory {max_memory}"
        )


_MAPPED = ("splatree", "splatree-folder")


@contextmanager
def _scene(command: Command, inputs: tuple[Path, ...], output: Path) -> Iterator[Scene]:
    """The scene, read; or mapped, where it is a folder of parts."""
    if len(inputs) == 1 and holds_parts(inputs[0]):
        with mapped_whole(inputs[0], output) as scene:
            yield scene
    else:
        yield read_scene(inputs, command.reading)


def _streamed(command: Command, read: Scene, output: Path) -> Result:
    read = of_degree(read, command.options.sh_degree, scratch_beside(output, command.max_memory).part(0.5))
    scene = with_levels(read)
    written = stream(
        *(scene, output, command.format, command.options), force=command.force, max_memory=command.max_memory
    )
    report = None
    if command.report is not None:
        cameras = None if command.cameras is None else list(read_cameras(command.cameras, source=scene.source))
        report = report_stream(scene, written, cameras)
        if command.report.suffix.lower() in (".html", ".htm"):
            write_stream_report(report, scene, written, command.report, cameras, force=True)
        else:
            with replacing(command.report, force=True) as temporary:
                temporary.write_text(report.to_json(), "utf-8")
    origin = scene.source.origin
    relative = (
        [f"the origin {origin_in_words(origin)}: coordinates of the stream are relative to it"] if any(origin) else []
    )
    built_levels = read.tree.num_leaves == len(read)
    return Result(written, built_levels, repairs_of(read), *lost_and_noted(read, relative), report)


def _inputs_and_output(command: Command) -> tuple[tuple[Path, ...], Path]:
    paths, output = command.paths, command.output
    if output is None:
        if len(paths) < 2:
            found = "one path" if paths else "no path"
            raise UsageError(f"found {found}, wanted an input and an output: city.splatree city_stream")
        *sources, output = paths
        paths = tuple(sources)
    if not paths:
        raise UsageError("found no input, wanted at least one: city.splatree -o city_stream")
    if any(path.exists() and output.exists() and path.samefile(output) for path in paths):
        raise UsageError(f"{output}: is an input too; choose another name for the output")
    return paths, output


def show(result: Result) -> str:
    """The result in words."""
    written = result.written
    kept = f", {written.num_parts_kept} of them there already" if written.num_parts_kept else ""
    if written.num_parts_damaged:
        kept += f", {written.num_parts_damaged} made again that {'was' if written.num_parts_damaged == 1 else 'were'} damaged"
    lines = [
        *(["levels of detail: built first, as the input has none"] if result.built_levels else []),
        f"wrote {written.output}: {counted(written.num_chunks, 'chunk')} in {counted(written.num_parts, 'part')}{kept}, "
        f"{size(written.bytes)}",
        *told(result.repairs, result.lost, result.notes),
    ]
    if len(written.levels) > 1:
        lines = [table([_level_in_words(level) for level in written.levels]), *lines]
    if result.report is not None:
        lines.append(table([_in_words(view) for view in result.report.views]))
    return "\n".join(lines)


def _level_in_words(level: LevelWritten) -> dict[str, str | int | float]:
    return {
        "level": level.level,
        "nodes": level.num_nodes,
        "extent": level.size,
        "files": level.num_files,
        "size": size(level.bytes),
    }


def _in_words(view: ViewQuality) -> dict[str, str | int | float | None]:
    setting = f"{view.setting:g} px" if view.viewer == "cesium" else f"{view.setting:,.0f}"
    return {
        "view": view.view,
        "viewer": view.viewer,
        "setting": setting,
        "nodes": view.num_nodes,
        "loaded": size(view.bytes),
        "PSNR, dB": view.psnr_db,
        "exact cut, dB": view.exact_psnr_db,
    }
