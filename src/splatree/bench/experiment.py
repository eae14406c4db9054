"""What an experiment leaves: tables and figures that say where each number comes from.

An experiment is a module of this package with two names: ``Options``, a dataclass whose fields are the command line's options
(their docstrings are the help), and ``run(options)``, which returns a `Report`. Nothing here prints, and nothing here is written
unless `splatree.bench.files.write_report` is called. A table is either measured in this run or transcribed from a paper, and
its ``source`` says which: the two are never mixed in one table.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from splatree.shapes import Array

__all__ = ["MEASURED", "Curve", "Grid", "Lanes", "Panel", "Plot", "Report", "Row", "Table"]

MEASURED = "measured in this run"
"""Source of a table whose numbers were computed here."""

Row = Mapping[str, object]
"""Numbers, words or None by the name of the column."""


@dataclass(frozen=True)
class Table:
    """Rows with named columns."""

    name: str
    """Name of its file, without suffix."""
    title: str
    """What the rows are."""
    rows: Sequence[Row]
    """One mapping a row; columns in the order in which they first appear."""
    source: str = MEASURED
    """Where the numbers come from: this run, or a paper and its table."""
    notes: Sequence[str] = ()
    """What a reader has to know to compare the numbers."""


@dataclass(frozen=True)
class Curve:
    """Points joined by a line."""

    label: str
    """Name in the legend."""
    x: Sequence[float]
    """Positions."""
    y: Sequence[float]
    """Values."""
    theirs: bool = False
    """Whether the points are from a paper: drawn dashed."""


@dataclass(frozen=True)
class Plot:
    """Curves over a common axis."""

    name: str
    """Name of its file, without suffix."""
    title: str
    """Heading."""
    x_label: str
    """Quantity and unit."""
    y_label: str
    """Quantity and unit."""
    curves: Sequence[Curve]
    """In the order of the legend."""
    log_x: bool = False
    """Whether positions are spaced by their logarithm."""
    log_y: bool = False
    """The same for values."""


@dataclass(frozen=True)
class Lanes:
    """Stretches of time, a lane for each of what works."""

    name: str
    """Name of its file, without suffix."""
    title: str
    """Heading."""
    x_label: str
    """Quantity and unit of time."""
    lanes: Mapping[str, Sequence[tuple[float, float]]]
    """Begin and length of each stretch, by the lane's name, from the top."""


@dataclass(frozen=True, eq=False)
class Panel:
    """A picture with its caption."""

    caption: str
    """One or two short lines."""
    image: Array
    """RGB, 0 to 1, (h w 3)."""


@dataclass(frozen=True, eq=False)
class Grid:
    """Pictures in rows and columns."""

    name: str
    """Name of its file, without suffix."""
    title: str
    """Heading."""
    rows: Sequence[Sequence[Panel]]
    """Row by row; all of one length."""


@dataclass(frozen=True, eq=False)
class Report:
    """All that an experiment found."""

    name: str
    """The experiment."""
    title: str
    """What it shows, in a sentence."""
    about: Mapping[str, str]
    """Scene, cameras, rules, machine, version: what a reader needs to run it again."""
    tables: Sequence[Table]
    """Measured ones first."""
    figures: Sequence[Plot | Lanes | Grid] = field(default=())
    """Drawn only when they are written to files."""
