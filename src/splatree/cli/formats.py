"""``splatree formats``: what can be read and written."""

from dataclasses import dataclass
from typing import Annotated

from tyro.conf import arg

from splatree.cli.console import Console, table
from splatree.io.registry import Format, formats


@dataclass(frozen=True)
class Command:
    """List the formats that are read and written."""

    console: Annotated[Console, arg(name="", help="")] = Console()


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
    chunks: str
    """Files larger than memory: `from and to` them, `from`, `to` or `no`."""
    options: tuple[str, ...]
    """Options of `splatree convert` that its writer takes."""
    lossless: bool
    """Whether columns that are written read back bit for bit."""
    levels: str
    """Levels of detail: `none`; `one of` several is read; the `tree` is kept."""
    sh_degree: int
    """Largest degree of harmonics."""
    modes: tuple[str, ...]
    """Modes that a file can name."""
    threshold: bool
    """Whether a file names τ."""
    record: bool
    """Whether the file says how its levels were made and are to be drawn."""
    clusters: bool
    """Whether clusters are kept."""
    origin: bool
    """Whether coordinates far from zero keep their digits."""
    curves: bool
    """Whether the file keeps how merged nodes follow the pixel that they are drawn at."""
    axes: str
    """Axes that the format prescribes."""


def run(command: Command) -> tuple[FormatLine, ...]:
    """The formats in the order in which they are tried."""
    return tuple(
        FormatLine(
            name=f.name,
            description=f.description,
            suffixes=f.suffixes,
            versions=f.versions,
            written=f.is_written,
            chunks=_chunks(f),
            options=f.options,
            **vars(f.holds),
        )
        for f in formats()
    )


def _chunks(f: Format) -> str:
    ways = [
        way
        for way, function in (("from", f.read_chunks or f.read_leaves), ("to", f.write_chunks))
        if function is not None
    ]
    return " and ".join(ways) or "no"


def show(lines: tuple[FormatLine, ...]) -> str:
    """The formats as a table."""
    return table(
        [
            {
                "format": line.name,
                "suffix": " ".join(line.suffixes) or "(folder)",
                "": "read, write" if line.written else "read",
                "values": "exact" if line.lossless else "rounded",
                "SH": line.sh_degree,
                "modes": ", ".join(line.modes),
                "levels": line.levels,
                "in chunks": line.chunks,
                "versions": line.versions,
                "what": line.description,
            }
            for line in lines
        ]
    )
