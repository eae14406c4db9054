import io
import json

import pytest

from splatree.cli import console
from splatree.cli.console import Console, counted, progress_shown, size, table
from splatree.progress import task


class Terminal(io.StringIO):
    def isatty(self):
        return True


def shown(monkeypatch, stream, flags, patience_s=0.0):
    """What a task of two steps leaves on a stream in place of stderr."""
    monkeypatch.setattr(
        "sys.stderr", stream
    )  # here, not in a fixture: pytest renews sys.stderr before the test is called
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setattr(console, "PATIENCE_S", patience_s)
    with progress_shown(flags), task("work", 2) as advance:
        advance(1)
    return stream.getvalue()


def test_bar_appears_once_a_task_has_taken_long(monkeypatch):
    assert "work" in shown(monkeypatch, Terminal(), Console())
    assert shown(monkeypatch, Terminal(), Console(), patience_s=float("inf")) == ""


def test_no_bar_when_quiet_or_without_a_terminal(monkeypatch):
    assert shown(monkeypatch, Terminal(), Console(quiet=True)) == ""
    assert shown(monkeypatch, io.StringIO(), Console()) == ""


def test_progress_as_json_knows_what_is_left(monkeypatch):
    clock = iter([0.0, 2.0, 2.1, 3.0, 4.0])
    stream = io.StringIO()
    monkeypatch.setattr("sys.stderr", stream)
    monkeypatch.setattr(console.time, "perf_counter", lambda: next(clock))
    with progress_shown(Console(progress="json", quiet=True)), task("grow", 100, done=50) as advance:
        advance(10)
        advance(1)  # too soon for a line
        advance(9)
    lines = [json.loads(line) for line in stream.getvalue().splitlines()]
    assert [(line["done"], line["elapsed_s"], line["left_s"]) for line in lines] == [
        (50, 0, None),
        (60, 2, 8),  # ten took two seconds, forty are left
        (70, 3, 4.5),
        (70, 4, 6),
    ]
    assert [line["finished"] for line in lines] == [False, False, False, True]


@pytest.mark.parametrize("stream", [Terminal, io.StringIO])
def test_verbose_says_what_each_step_took(monkeypatch, stream):
    assert shown(monkeypatch, stream(), Console(verbose=True)).startswith("work: ")


def test_table_aligns_numbers_right_and_words_left():
    rows = [{"name": "a", "n": 1234, "dB": 3.14159}, {"name": "long", "n": 5, "dB": None}]
    assert table(rows).splitlines() == ["name      n    dB", "a     1,234  3.14", "long      5"]


@pytest.mark.parametrize(
    ("num_bytes", "words"),
    [(0, "0 bytes"), (1023, "1023 bytes"), (1024, "1.0 KiB"), (3 << 20, "3.0 MiB"), (5 << 40, "5,120.0 GiB")],
)
def test_sizes_are_said_in_the_largest_unit_that_fits(num_bytes, words):
    assert size(num_bytes) == words


def test_numbers_have_their_nouns_in_the_singular_or_the_plural():
    assert [counted(n, "level") for n in (0, 1, 2000)] == ["0 levels", "1 level", "2,000 levels"]
