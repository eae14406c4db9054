"""``splatree thin``: fewer Gaussians that look alike, merged rather than dropped."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

from tyro.conf import arg

from splatree.cli.comparison import Reporting, in_words, read_back
from splatree.cli.console import Console, UsageError, counted, size
from splatree.cli.files import Files, inputs_and_output, lost_and_noted, read_options, read_scene, repairs_of, told
from splatree.cli.folders import Memory
from splatree.io.registry import stored_bytes
from splatree.io.writing import write
from splatree.outofcore.thin import thin_file
from splatree.render.compare_page import Comparison
from splatree.scene.names import Mode
from splatree.scene.thinning import ThinOptions
from splatree.simplify.thin import thin


@dataclass(frozen=True)
class Command:
    """Merge Gaussians that are close or alike: to a share, a count or a radius; to the radius `auto` if none is given.

    A scene larger than memory is thinned by a radius through files, with the same result: --max-memory 4G, and with a share or a
    count --method radius.
    """

    files: Annotated[Files, arg(name="", help="")]
    mode: Mode | None = None
    """How the scene was trained and is drawn: merging follows it. None: as the file says, else `classic`."""
    options: Annotated[ThinOptions, arg(name="", help="")] = ThinOptions()
    running: Annotated[Memory, arg(name="", help="")] = Memory()
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
    """Gaussians written."""
    radius: float | None
    """r, world units, given or found; None for `pairs`."""
    rounds: int | None
    """Rounds: of pairs, or of parallel decisions; None: cells have rounds of their own."""
    options: ThinOptions
    """The rules."""
    bytes: int
    """Size of the file; of a folder of SOG, of all files that its meta.json names."""
    repairs: dict[str, int]
    """How many values or rows each rule of repair touched."""
    lost: tuple[str, ...]
    """What of the inputs the file does not hold, a sentence each."""
    notes: tuple[str, ...] = ()
    """What reading did that the user should know, a sentence each."""
    comparison: Comparison | None = None
    """What was lost in pictures, if --report asks for it."""


def run(command: Command) -> Result:
    """Read the leaves, thin them, write."""
    inputs, output = inputs_and_output(command.files)
    command.reporting.check(force=command.files.force)
    if command.running != Memory():
        return _through_files(command, inputs, output)
    scene = read_scene(inputs, command.files.reading)
    if command.mode is not None:
        scene = replace(scene, mode=command.mode)
    thinned = thin(scene, command.options)
    lost = write(thinned.scene, output, force=command.files.force)
    lost, notes = lost_and_noted(scene, lost)
    return Result(
        output=output,
        num_read=scene.tree.num_leaves,
        num_gaussians=len(thinned),
        radius=thinned.radius,
        rounds=thinned.groups.rounds,
        options=thinned.options,
        bytes=stored_bytes(output),
        repairs=repairs_of(scene),
        lost=lost,
        notes=notes,
        comparison=read_back(
            output, scene, command.reporting, made_from=", ".join(map(str, inputs)), force=command.files.force
        ),
    )


def _through_files(command: Command, inputs: Sequence[Path], output: Path) -> Result:
    if command.options.chosen_method != "radius":
        raise UsageError(
            "found --max-memory, --workers, --scheduler or --part-rows with a share or a count by pairs, which need the scene in "
            "memory; wanted --method radius"
        )
    if command.reporting != Reporting():
        raise UsageError("found --report with --max-memory, --workers, --scheduler or --part-rows; wanted one of them")
    reading, force = read_options(command.files.reading), command.files.force
    running = command.running.options()
    done = thin_file(inputs, output, command.options, running, reading=reading, mode=command.mode, force=force)
    return Result(
        output=output,
        num_read=done.num_read,
        num_gaussians=done.num_written,
        radius=done.radius,
        rounds=None,
        options=done.options,
        bytes=stored_bytes(output),
        repairs=done.repairs,
        lost=done.lost,
        notes=done.notes,
    )


def show(result: Result) -> str:
    """The result in words."""
    share = 100 * result.num_gaussians / max(1, result.num_read)
    how = f"{counted(result.rounds or 0, 'round')} of pairs" if result.radius is None else f"radius {result.radius:.4g}"
    wrote = (
        f"wrote {result.output}: {result.num_gaussians:,} of {counted(result.num_read, 'Gaussian')} ({share:.1f} %), "
        f"{how}, {size(result.bytes)}"
    )
    compared = [] if result.comparison is None else in_words(result.comparison)
    return "\n".join([wrote, *told(result.repairs, result.lost, result.notes), *compared])
