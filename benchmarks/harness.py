"""What every benchmark shares: the machine, the cost of a piece of work, and the file of results.

A benchmark is ``benchmarks/<name>.py``, one command. It measures with `measure`, compares within the same run (ratios, since
clocks differ), prints its table with `table` and keeps it with `save`; ``python benchmarks/report.py`` turns all kept
results into RESULTS.md. Cost is given as processor seconds, which other work on the machine disturbs least, with the wall
clock and the peak memory beside them.
"""

import json
import os
import platform
import resource
import shlex
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
RESULTS = ROOT / "benchmarks" / "results"
DATA = ROOT.parent / "shared" / "data"
"""Large real scenes; a benchmark that needs them says so and stops if they are not there."""

Row = Mapping[str, Any]


@dataclass(frozen=True)
class Cost:
    """What a piece of work took."""

    cpu_s: float
    """Processor seconds, user and system, of all threads (and of child processes if it was a command)."""
    wall_s: float
    """Seconds on the clock."""
    peak_bytes: int
    """Largest resident memory while it ran; of the whole process, so it includes what was loaded before."""
    value: Any = None
    """What the function returned; the standard output of a command."""


def measure(work: Callable[[], Any] | Sequence[str | Path], *, repeat: int = 1) -> Cost:
    """Cost of a function in this process, or of a command in a process of its own; of ``repeat`` runs the cheapest.

    The peak memory of a function needs Linux (its high-water mark is reset first); elsewhere it is that of the process so far.
    """
    run = _measure_function if callable(work) else _measure_command
    return min((run(work) for _ in range(repeat)), key=lambda cost: cost.cpu_s)  # type: ignore[arg-type]


def save(name: str, rows: Sequence[Row], *, about: str) -> Path:
    """Keep the rows of benchmark ``name`` with machine, commit and command; ``about`` says in a sentence what they show."""
    content = {
        "name": name,
        "about": about,
        "command": shlex.join(["python", *_shortened(sys.argv)]),
        "commit": _commit(),
        "date": datetime.now(UTC).strftime("%Y-%m-%d"),
        "machine": machine(),
        "rows": [dict(row) for row in rows],
    }
    RESULTS.mkdir(parents=True, exist_ok=True)
    path = RESULTS / f"{name}.json"
    path.write_text(json.dumps(content, indent=1, ensure_ascii=False, default=_plain) + "\n")
    return path


def machine() -> dict[str, str]:
    """Processor, instruction set in use, threads, memory and versions."""
    import numpy

    from splatree.kernels.cpu import _core

    return {
        "processor": _processor(),
        "instruction set": str(_core.isa()),
        "threads": str(_core.hardware_threads()),
        "memory": f"{os.sysconf('SC_PAGE_SIZE') * os.sysconf('SC_PHYS_PAGES') / 2**30:.0f} GiB",
        "system": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
        "numpy": numpy.__version__,
    }


def table(rows: Sequence[Row]) -> str:
    """The rows as a table in Markdown, one column for each key; numbers with four significant digits."""
    columns = list(dict.fromkeys(key for row in rows for key in row))
    cells = [columns] + [[_cell(row.get(column, "")) for column in columns] for row in rows]
    widths = [max(len(line[i]) for line in cells) for i in range(len(columns))]
    numeric = [all(not isinstance(row.get(column, 0), str) for row in rows) for column in columns]
    lines = [
        "| "
        + " | ".join(c.rjust(w) if right else c.ljust(w) for c, w, right in zip(line, widths, numeric, strict=True))
        + " |"
        for line in cells
    ]
    rule = (
        "|"
        + "|".join("-" * (w + 1) + ":" if right else "-" * (w + 2) for w, right in zip(widths, numeric, strict=True))
        + "|"
    )
    return "\n".join([lines[0], rule, *lines[1:]])


def _measure_function(work: Callable[[], Any]) -> Cost:
    _reset_peak()
    wall, cpu = time.perf_counter(), time.process_time()
    value = work()
    cpu, wall = time.process_time() - cpu, time.perf_counter() - wall
    return Cost(cpu, wall, _peak_bytes(), value)


def _measure_command(command: Sequence[str | Path]) -> Cost:
    words = [str(word) for word in command]
    wall = time.perf_counter()
    with subprocess.Popen(words, stdout=subprocess.PIPE, stdin=subprocess.DEVNULL, text=True) as child:
        assert child.stdout is not None
        output = child.stdout.read()
        _, status, usage = os.wait4(child.pid, 0)
        child.returncode = os.waitstatus_to_exitcode(status)
    wall = time.perf_counter() - wall
    if child.returncode != 0:
        raise subprocess.CalledProcessError(child.returncode, words, output)
    return Cost(usage.ru_utime + usage.ru_stime, wall, usage.ru_maxrss * _RSS_UNIT, output)


_RSS_UNIT = 1 if sys.platform == "darwin" else 1024
"""Bytes in a unit of ru_maxrss: kB on Linux, bytes on macOS."""


def _reset_peak() -> None:
    refs = Path("/proc/self/clear_refs")
    if refs.exists():
        refs.write_text("5")  # 5 resets the high-water mark of the resident set (man 5 proc)


def _peak_bytes() -> int:
    status = Path("/proc/self/status")
    if status.exists():
        line = next(line for line in status.read_text().splitlines() if line.startswith("VmHWM"))
        return int(line.split()[1]) * 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * _RSS_UNIT


def _processor() -> str:
    info = Path("/proc/cpuinfo")
    if info.exists():
        names = [
            line.split(":", 1)[1].strip() for line in info.read_text().splitlines() if line.startswith("model name")
        ]
        if names:
            return names[0]
    return platform.processor() or platform.machine()


def _commit() -> str:
    def git(*words: str) -> str:
        return subprocess.run(
            ["git", "-C", str(ROOT), *words], capture_output=True, text=True, check=True
        ).stdout.strip()

    try:
        # Results that are being rewritten do not make the code another one.
        changed = git("status", "--porcelain", "--untracked-files=no", "--", "src", "CMakeLists.txt")
        return git("rev-parse", "--short", "HEAD") + (" + changes" if changed else "")
    except (OSError, subprocess.CalledProcessError):
        return "not a git checkout"


def _shortened(argv: Sequence[str]) -> list[str]:
    """The command's words; absolute paths relative to the repository, or only their last part: no folders of this machine."""

    def short(word: str) -> str:
        path = Path(word)
        if not path.is_absolute():
            return word
        return str(path.relative_to(ROOT)) if path.is_relative_to(ROOT) else path.name

    return [short(word) for word in argv]


def _cell(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.4g}" if abs(value) < 1e4 else f"{value:,.0f}"
    if isinstance(value, int) and not isinstance(value, bool):
        return f"{value:,}"
    return str(value)


def _plain(value: Any) -> Any:
    """NumPy scalars and arrays as plain numbers."""
    if hasattr(value, "tolist"):
        return value.tolist()
    raise TypeError(f"save: found a {type(value).__name__} in a row, wanted numbers and strings")
