"""``splatree rtl``: circuits of the accelerator as Verilog."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import arg

from splatree.cli.console import Console, table
from splatree.hardware.rtl.verilog import TOP_MODULES, Engine, generic_cells, verilog
from splatree.io.replacing import replacing


@dataclass(frozen=True)
class Command:
    """Write the cluster identification engine, or a lane of step 1, as Verilog (needs the extra `rtl`).

    splatree rtl -o cie.v --cells
    splatree rtl -o lane.v --engine step1
    """

    output: Annotated[Path, arg(aliases=["-o"])]
    """The Verilog file."""
    engine: Engine = "identification"
    """`identification` decides which clusters are kept; `step1` projects a Gaussian a cycle."""
    cells: bool = False
    """Also synthesise it to generic cells and count them; takes a minute, a lane of step 1 many."""
    force: bool = False
    """Replace the file if it is there."""
    console: Annotated[Console, arg(name="", help="")] = Console()


@dataclass(frozen=True)
class Result:
    """What was written."""

    output: Path
    """The file."""
    top_module: str
    """Name of the top module."""
    lines: int
    """Lines of Verilog."""
    cells: dict[str, int]
    """Generic cells by kind; empty if they were not counted."""


def run(command: Command) -> Result:
    """Write the file."""
    text = verilog(command.engine)
    with replacing(command.output, force=command.force) as temporary:
        temporary.write_text(text, "utf-8")
    cells = generic_cells(text, command.engine) if command.cells else {}
    return Result(command.output, TOP_MODULES[command.engine], text.count("\n"), cells)


def show(result: Result) -> str:
    """The result in words."""
    words = f"wrote {result.output}: {result.lines:,} lines of Verilog, top module {result.top_module}"
    if not result.cells:
        return words
    rows = [{"cell": kind, "count": count} for kind, count in sorted(result.cells.items(), key=lambda item: -item[1])]
    return f"{words}\n{sum(result.cells.values()):,} generic cells\n{table(rows)}"
