"""``splatree bench <experiment>``: a table or figure of a paper run again, or a test of levels, on any scene."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Annotated, Generic, TypeVar

from tyro.conf import arg

from splatree.bench import accelerator, clusters, cullfuzz, fig5, fig6, fig7, popping, table1, table2, table3
from splatree.bench.draw import check_drawable
from splatree.bench.experiment import Report, Table
from splatree.bench.files import write_report
from splatree.cli.console import Console, table
from splatree.io.replacing import check_free_in

T = TypeVar("T")


@dataclass(frozen=True)
class Command(Generic[T]):
    """The options of one experiment, and what all of them have."""

    experiment: Annotated[T, arg(name="", help="")]
    output: Annotated[Path | None, arg(aliases=["-o"])] = None
    """Folder for the tables (CSV, JSON) and figures (PNG, needs the extra `bench`); None: the tables are printed only."""
    force: bool = False
    """Replace results that are there."""
    console: Annotated[Console, arg(name="", help="")] = Console()


COMMANDS = {
    "table1": Command[table1.Options],
    "table2": Command[table2.Options],
    "table3": Command[table3.Options],
    "fig5": Command[fig5.Options],
    "fig6": Command[fig6.Options],
    "fig7": Command[fig7.Options],
    "clusters": Command[clusters.Options],
    "cullfuzz": Command[cullfuzz.Options],
    "popping": Command[popping.Options],
    "accelerator": Command[accelerator.Options],
}
"""The experiments: modules of `splatree.bench`, whose ``Options`` say in their docstrings what is measured."""


@dataclass(frozen=True)
class Benched:
    """What an experiment found."""

    name: str
    """The experiment."""
    title: str
    """What it shows."""
    about: Mapping[str, str]
    """Scene, cameras, rules, machine, version."""
    tables: Sequence[Table]
    """Measured ones first; each names its source."""
    files: tuple[Path, ...]
    """What was written."""


def run(command: Command[T]) -> Benched:
    """Run the experiment whose options these are, and write its report."""
    if command.output is not None:
        check_drawable()
        name = type(command.experiment).__module__.rpartition(".")[2]
        check_free_in(command.output, [f"{name}.json"], force=command.force)
    report: Report = import_module(type(command.experiment).__module__).run(command.experiment)
    written = write_report(report, command.output, force=command.force) if command.output is not None else ()
    return Benched(report.name, report.title, report.about, report.tables, written)


def show(benched: Benched) -> str:
    """The tables, each with its source."""
    about = "\n".join(f"{key}: {value}" for key, value in benched.about.items())
    parts = [f"{benched.title}\n{about}"]
    for one in benched.tables:
        notes = "".join(f"\n{note}" for note in one.notes)
        parts.append(f"{one.title} ({one.source})\n{table(one.rows)}{notes}")
    if benched.files:
        parts.append("wrote " + ", ".join(str(path) for path in benched.files))
    return "\n\n".join(parts)
