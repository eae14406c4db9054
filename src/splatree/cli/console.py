"""What every verb shares: the flags of the output, progress on the terminal, tables in plain text, the error of a wrong line."""

import json
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Annotated, Any, Literal

from tyro.conf import arg

from splatree.cli.plain import printable
from splatree.errors import InputError
from splatree.progress import Event, Sink, listen

JSON_EACH_S = 0.5
"""A step has one line of JSON in so many seconds."""

PATIENCE_S = 1.0
"""Bars appear once a task has taken this long."""


class UsageError(InputError):
    """A command line that lacks something or contradicts itself: exit code 2."""


@dataclass(frozen=True)
class Console:
    """What is printed."""

    json: bool = False
    """Print the result as JSON on stdout; everything else goes to stderr."""
    verbose: Annotated[bool, arg(aliases=["-v"])] = False
    """Say what each step took, and where an error came from."""
    progress: Literal["bars", "json"] = "bars"
    """Show progress as `bars` on a terminal, or as `json`: lines on stderr, at most two a second for each step, with what is
    done, how much there is, and how many seconds are left."""
    quiet: Annotated[bool, arg(aliases=["-q"])] = False
    """Print neither bars nor a summary; errors, --json and --progress json still appear."""


@contextmanager
def progress_shown(console: Console) -> Iterator[None]:
    """Show the library's progress: bars on a terminal, lines of finished steps with ``--verbose``, or JSON."""
    if sys.stderr is None:  # closed by whoever started the program
        yield
    elif console.progress == "json":
        with listen(_json_lines()):
            yield
    elif console.verbose:
        with listen(_lines()):
            yield
    elif sys.stderr.isatty() and not console.quiet:
        with _bars() as sink, listen(sink):
            yield
    else:
        yield


def size(num_bytes: int) -> str:
    """Bytes in words: of the largest unit of which it is at least one."""
    for power, unit in ((3, "GiB"), (2, "MiB"), (1, "KiB")):
        if num_bytes >= 1024**power:
            return f"{num_bytes / 1024**power:,.1f} {unit}"
    return f"{num_bytes} bytes"


def counted(number: int, noun: str) -> str:
    """A number with its noun in the singular or the plural: 1 level, 2,000 levels."""
    return f"{number:,} {noun}{'' if number == 1 else 's'}"


def table(rows: Sequence[Mapping[str, Any]]) -> str:
    """Rows as aligned columns; numbers to the right."""
    columns = list(dict.fromkeys(key for row in rows for key in row))
    cells = [columns] + [[_cell(row.get(column, "")) for column in columns] for row in rows]
    widths = [max(len(line[i]) for line in cells) for i in range(len(columns))]
    left = [any(isinstance(row.get(column), str) for row in rows) for column in columns]
    return "\n".join(
        "  ".join(
            c.ljust(w) if is_left else c.rjust(w) for c, w, is_left in zip(line, widths, left, strict=True)
        ).rstrip()
        for line in cells
    )


def _cell(value: Any) -> str:
    if isinstance(value, float):
        digits = 4 if 0 < abs(value) < 1 else 2 if abs(value) < 100 else 0
        return f"{value:,.{digits}f}"
    if isinstance(value, int) and not isinstance(value, bool):
        return f"{value:,}"
    return "" if value is None else str(value)


def _lines() -> Sink:
    started: dict[str, float] = {}

    def sink(event: Event) -> None:
        begin = started.setdefault(event.name, time.perf_counter())
        if event.finished:
            line = f"{event.name}: {time.perf_counter() - begin:.2f} s"
            with suppress(OSError):  # it may be full, or its reader gone: the work goes on
                print(printable(line, sys.stderr), file=sys.stderr, flush=True)
            del started[event.name]

    return sink


def _json_lines() -> Sink:
    """A line for the beginning and the end of each step, and in between at most one each half second."""
    begun: dict[str, Event] = {}
    times: dict[str, tuple[float, float]] = {}  # when it began, and when a line was printed last

    def sink(event: Event) -> None:
        now = time.perf_counter()
        first = begun.setdefault(event.name, event)
        began, last = times.setdefault(event.name, (now, float("-inf")))
        if now - last < JSON_EACH_S and not event.finished:
            return
        times[event.name] = (began, now)
        elapsed, new = now - began, event.done - first.done  # what was done before says nothing of the speed
        left = None if event.total is None or not new else elapsed * (event.total - event.done) / new
        line = {"step": event.name, "done": event.done, "total": event.total, "elapsed_s": round(elapsed, 3)}
        line |= {"left_s": left if left is None else round(left, 3), "finished": event.finished}
        with suppress(OSError):  # as in _lines
            print(printable(json.dumps(line), sys.stderr), file=sys.stderr, flush=True)
        if event.finished:
            del begun[event.name], times[event.name]

    return sink


@contextmanager
def _bars() -> Iterator[Sink]:
    from rich.console import Console as Terminal
    from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn(), TimeRemainingColumn())
    progress = Progress(*columns, console=Terminal(stderr=True), transient=True)
    started: dict[str, float] = {}
    bars: dict[str, TaskID] = {}

    def sink(event: Event) -> None:
        begin = started.setdefault(event.name, time.perf_counter())
        if event.finished:
            del started[event.name]
            if event.name in bars:
                progress.remove_task(bars.pop(event.name))
        elif time.perf_counter() - begin >= PATIENCE_S:
            if event.name not in bars:
                bars[event.name] = progress.add_task(event.name, total=event.total)
                progress.start()  # draws at once, if it is the first
            progress.update(bars[event.name], completed=event.done)

    try:
        yield sink
    finally:
        progress.stop()
