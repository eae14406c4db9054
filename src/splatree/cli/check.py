"""``splatree check``: whether files are whole."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from splatree.cli.console import Console, counted, size
from splatree.cli.files import Reading, check_inputs, read_options
from splatree.outofcore.check import Checked, check


@dataclass(frozen=True)
class Command:
    """Touch everything of a scene on disk: digests, values, levels, indices. An error says what is damaged, and where.

    A scene that is larger than memory is drawn page by page, so a damaged page may be met late. It is checked page by page, too.
    """

    paths: Positional[tuple[Path, ...]]
    """Files or folders; each is checked by itself."""
    reading: Annotated[Reading, arg(name="", help="")] = Reading()
    console: Annotated[Console, arg(name="", help="")] = Console()


@dataclass(frozen=True)
class Result:
    """What was checked, and is whole."""

    paths: tuple[Path, ...]
    """Files or folders that were named."""
    scenes: tuple[Checked, ...]
    """What was found in them, in their order."""


def run(command: Command) -> Result:
    """Check one after the other; the first that is damaged ends it."""
    check_inputs(command.paths)
    return Result(command.paths, check(command.paths, read_options(command.reading)))


def show(result: Result) -> str:
    """A line for each scene."""
    return "\n".join(_line(scene) for scene in result.scenes)


def _line(scene: Checked) -> str:
    merged = scene.num_nodes - scene.num_gaussians
    more = f"{merged:,} of coarser tiles" if scene.format == "3d-tiles" else counted(merged, "merged node")
    levels = f" and {more}" if merged else ""
    return f"whole: {scene.path}, {scene.format}, {counted(scene.num_gaussians, 'Gaussian')}{levels}, {size(scene.num_bytes)}"
