"""The benchmark of the GPU back end runs through on the emulator, so that it does on a machine that is rented by the minute."""

import subprocess
import sys
from pathlib import Path

from .kernels.simt_device import Emulator

ROOT = Path(__file__).parent.parent


def test_a_dry_run_goes_through_every_kind_of_row(emulator: Emulator) -> None:
    folder = Path(emulator.library._name).parent
    words = [sys.executable, "-W", "error", str(ROOT / "benchmarks" / "gpu.py"), "--dry", str(folder)]
    run = subprocess.run(words, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    assert run.stdout == "dry run: 9 rows, 5 kinds\n"
