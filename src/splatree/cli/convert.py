"""``splatree convert``: a scene in another format."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import arg

from splatree.cli.console import Console
from splatree.cli.files import Files, inputs_and_output
from splatree.io.options import WriteOptions
from splatree.io.registry import read, write


@dataclass(frozen=True)
class Command:
    """Write a scene in another format, which the suffix of the output names."""

    files: Annotated[Files, arg(name="")]
    level: int | None = None
    """Level of detail to read from a format that has several; 0 is the finest."""
    depth: int | None = None
    """Write one cut of the tree to a format without levels: the nodes at this depth, 0 the roots; None: the leaves."""
    options: Annotated[WriteOptions, arg(name="")] = WriteOptions()
    console: Annotated[Console, arg(name="")] = Console()


@dataclass(frozen=True)
class Converted:
    """What was written."""

    output: Path
    """The file."""
    num_gaussians: int
    """Gaussians read, without merged ones."""
    bytes: int
    """Size of the file."""
    repairs: str | None
    """What was fixed or dropped while reading, as JSON; None if nothing was."""
    lost: tuple[str, ...]
    """What of the inputs the file does not hold, a sentence each."""


def run(command: Command) -> Converted:
    """Read, then write."""
    inputs, output = inputs_and_output(command.files)
    scene = read(inputs, level=command.level, repair=command.files.repair)
    lost = write(scene, output, depth=command.depth, force=command.files.force, options=command.options)
    metadata = scene.source.metadata
    lost = (*json.loads(metadata.get("lost", "[]")), *lost)
    return Converted(output, scene.tree.num_leaves, output.stat().st_size, metadata.get("repairs"), lost)


def show(converted: Converted) -> str:
    """The result in words."""
    repairs = f"; repaired: {converted.repairs}" if converted.repairs else ""
    size = f"{converted.bytes / 2**20:.1f} MiB"
    lost = "".join(f"\nlost: {sentence}" for sentence in converted.lost)
    return f"wrote {converted.output}: {converted.num_gaussians:,} Gaussians, {size}{repairs}{lost}"
