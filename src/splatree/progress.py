"""Progress as events to a sink: the library tells, the caller shows.

``with listen(sink): build_lod(scene)`` sends each event of work done in this thread's context to ``sink``; without a
listener nothing happens. The command line shows bars with it.
"""

from collections.abc import Callable, Iterable, Iterator, Sized
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, replace
from typing import TypeVar

T = TypeVar("T")


@dataclass(frozen=True)
class Event:
    """One step of a named task."""

    name: str
    """What is being done: "read city.ply"."""
    done: float
    """Units finished so far."""
    total: float | None
    """Units in all; None if not known."""
    finished: bool = False
    """Whether the task has ended (also by an exception)."""


Sink = Callable[[Event], None]
_sink: ContextVar[Sink | None] = ContextVar("splatree_progress_sink", default=None)


@contextmanager
def listen(sink: Sink) -> Iterator[None]:
    """Send the events of the enclosed work to ``sink``."""
    token = _sink.set(sink)
    try:
        yield
    finally:
        _sink.reset(token)


@contextmanager
def renamed(old: str, new: str) -> Iterator[None]:
    """Let the names of the enclosed tasks have ``new`` in the place of ``old``."""
    sink = _sink.get()
    if sink is None:
        yield
        return
    with listen(lambda event: sink(replace(event, name=event.name.replace(old, new)))):
        yield


@contextmanager
def task(name: str, total: float | None = None, *, done: float = 0.0) -> Iterator[Callable[[float], None]]:
    """Announce a task, of which ``done`` units were done before; the value is a function ``advance(units)``."""
    sink = _sink.get()
    if sink is None:
        yield lambda units: None
        return

    def advance(units: float) -> None:
        nonlocal done
        done += units
        sink(Event(name, done, total))

    sink(Event(name, done, total))
    try:
        yield advance
    finally:
        sink(Event(name, done, total, finished=True))


def track(items: Iterable[T], name: str) -> Iterator[T]:
    """Yield ``items`` and report each."""
    total = len(items) if isinstance(items, Sized) else None
    with task(name, total) as advance:
        for item in items:
            yield item
            advance(1)
