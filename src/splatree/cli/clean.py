"""``splatree clean``: a scene without floaters and outliers."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import numpy as np
from tyro.conf import arg

from splatree.cli.console import Console, UsageError, counted, size
from splatree.cli.files import Files, inputs_and_output, read_options, told
from splatree.edit.clean import CleanOptions
from splatree.io.cameras.files import read_cameras
from splatree.io.cleaning import clean_file
from splatree.io.registry import stored_bytes


@dataclass(frozen=True)
class Command:
    """Drop what does not belong into a scene: Gaussians by size, by distance, and floaters that touch nothing.

    --dry-run says what each filter would drop, and writes nothing. Files larger than memory go through in chunks where both
    formats allow it (see `formats`).

    splatree clean city.ply --floaters --max-distance 5 --dry-run
    splatree clean city.ply clean.ply --floaters
    """

    files: Annotated[Files, arg(name="", help="")]
    dry_run: bool = False
    """Say what each filter would drop; write nothing. An output is not needed, and one that is not there yet is passed over."""
    cameras: Path | None = None
    """For --max-distance: cameras.json, transforms.json or a COLMAP model; distances are those to the nearest camera."""
    max_memory: str | None = None
    """What may be taken, such as 4G; what has no room lies in files beside the output. None: half of what is free."""
    options: Annotated[CleanOptions, arg(name="", help="")] = CleanOptions()
    console: Annotated[Console, arg(name="", help="")] = Console()


@dataclass(frozen=True)
class Result:
    """What was dropped."""

    output: Path | None
    """The file; None for a dry run."""
    num_read: int
    """Gaussians read, without merged ones."""
    num_gaussians: int
    """Gaussians left."""
    dropped: dict[str, int]
    """Gaussians that each filter drops; one that several drop counts for each."""
    bytes: int
    """Size of the file; 0 for a dry run."""
    repairs: dict[str, int]
    """How many values or rows each rule of repair touched."""
    lost: tuple[str, ...]
    """What of the inputs the file does not hold, a sentence each."""
    in_chunks: bool
    """Whether it went in chunks, with bounded memory."""
    notes: tuple[str, ...] = ()
    """What reading did that the user should know, a sentence each."""


def run(command: Command) -> Result:
    """Read, filter, write."""
    if command.options == replace(
        CleanOptions(), cell=command.options.cell, smallest_piece=command.options.smallest_piece
    ):
        raise UsageError("found no filter, wanted --floaters, --max-distance, --max-size or --min-size")
    if command.cameras is not None and command.options.max_distance is None:
        raise UsageError("cameras: found no --max-distance, wanted it: distances to the cameras are what they are for")
    if command.dry_run:
        inputs, output = _inputs_of_dry_run(command.files), None
    else:
        inputs, output = inputs_and_output(command.files)
    cameras = None
    if command.cameras is not None:
        cameras = np.array([camera.position for camera in read_cameras(command.cameras)])
    done = clean_file(
        inputs,
        output,
        command.options,
        cameras=cameras,
        reading=read_options(command.files.reading),
        max_memory=command.max_memory,
        force=command.files.force,
    )
    return Result(
        output=output,
        num_read=done.num_read,
        num_gaussians=done.num_written,
        dropped=done.dropped,
        bytes=0 if output is None else stored_bytes(output),
        repairs=done.repairs,
        lost=done.lost,
        in_chunks=done.in_chunks,
        notes=(*done.notes, *_doubts(done.num_read, done.dropped, command.options.cell)),
    )


def _doubts(num_read: int, dropped: Mapping[str, int], cell: float) -> tuple[str, ...]:
    """What to say where most of a scene was dropped as floaters: then there is no body that they float around."""
    if dropped.get("floaters", 0) <= num_read / 2:
        return ()
    return (
        f"most of the scene counts as floaters: its Gaussians are farther apart than cubes of {cell:g} radii; a larger --cell "
        "keeps more",
    )


def _inputs_of_dry_run(named: Files) -> tuple[Path, ...]:
    """The paths without the output, which the same command without --dry-run would have as its last."""
    if not named.paths:
        raise UsageError("found no path, wanted a scene")
    *inputs, last = named.paths
    return tuple(inputs) if inputs and named.output is None and not last.exists() else named.paths


def show(result: Result) -> str:
    """The result in words."""
    of = max(1, result.num_read)
    would = "would drop" if result.output is None else "dropped"
    lines = [f"{name}: {would} {count:,} ({100 * count / of:.2f} %)" for name, count in result.dropped.items()]
    left = f"{result.num_gaussians:,} of {counted(result.num_read, 'Gaussian')}"
    if result.output is None:
        return "\n".join([*lines, f"{left} would be left", *told({}, (), result.notes)])
    return "\n".join(
        [
            *lines,
            f"wrote {result.output}: {left}, {size(result.bytes)}",
            *told(result.repairs, result.lost, result.notes),
        ]
    )
