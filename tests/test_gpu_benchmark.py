"""The benchmark of the GPU back end runs through on the emulator, so that it does on a machine that is rented by the minute."""

import importlib
import subprocess
import sys
import time
from pathlib import Path

import pytest

from .kernels.simt_device import Emulator

ROOT = Path(__file__).parent.parent


def test_a_dry_run_goes_through_every_kind_of_row(emulator: Emulator) -> None:
    folder = Path(emulator.library._name).parent
    words = [sys.executable, "-W", "error", str(ROOT / "benchmarks" / "gpu.py"), "--dry", str(folder)]
    run = subprocess.run(words, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    assert run.stdout == "dry run: 9 rows, 5 kinds\n"


def test_a_part_that_has_used_its_time_is_ended_and_what_it_measured_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(ROOT / "benchmarks")
    gpu = importlib.import_module("gpu")
    prints = """print('{"what": "frame", "ms": 1}', flush=True); print('{"what":', end='', flush=True)"""
    start = time.monotonic()
    rows = gpu.rows_of("frame", [sys.executable, "-c", f"{prints}; import time; time.sleep(60)"], 5.0)
    assert time.monotonic() - start < 50
    assert rows[0] == {"what": "frame", "ms": 1}
    assert [row["what"] for row in rows] == ["frame", "frame"]
    assert "5 s of this part were used" in rows[1]["absent"]
    assert gpu.rows_of("frame", [sys.executable, "-c", "print('{}')"], 60) == [{}]


def test_a_part_that_fails_leaves_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(ROOT / "benchmarks")
    gpu = importlib.import_module("gpu")
    with pytest.raises(SystemExit, match="'frame' failed"):
        gpu.rows_of("frame", [sys.executable, "-c", "print('{}'); raise SystemExit(1)"], 60)


def test_the_parts_have_eight_minutes_together(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(ROOT / "benchmarks")
    gpu = importlib.import_module("gpu")
    assert sum(gpu.SECONDS.values()) <= 480
    assert [*gpu.SECONDS] == ["parity", *gpu.PARTS]
