"""``splatree formats``: what can be read and written."""

from dataclasses import dataclass
from typing import Annotated

from tyro.conf import arg

from splatree.cli.console import Console, table
from splatree.io.registry import formats


@dataclass(frozen=True)
class Command:
    """List the formats that are read and written."""

    console: Annotated[Console, arg(name="")] = Console()


@dataclass(frozen=True)
class FormatLine:
    """One format."""

    name: str
    """Short name."""
    description: str
    """What it is."""
    suffixes: tuple[str, ...]
    """Endings of file names; empty for folders."""
    versions: str
    """Versions that are read."""
    written: bool
    """Whether it is written too."""
    lossless: bool
    """Whether what is written reads back bit for bit."""
    levels: str
    """Levels of detail: `none`; `one of` several is read; the `tree` is kept."""


def run(command: Command) -> tuple[FormatLine, ...]:
    """The formats in the order in which they are tried."""
    return tuple(
        FormatLine(f.name, f.description, f.suffixes, f.versions, f.write is not None, f.lossless, f.levels)
        for f in formats()
    )


def show(lines: tuple[FormatLine, ...]) -> str:
    """The formats as a table."""
    return table(
        [
            {
                "format": line.name,
                "suffix": " ".join(line.suffixes) or "(folder)",
                "": "read, write" if line.written else "read",
                "levels": line.levels,
                "versions": line.versions,
                "what": line.description,
            }
            for line in lines
        ]
    )
