"""Run a frame on a machine: cycles, bytes, what each engine did, and what bounds the frame.

The core (kernels/cpu/machine) steps through the cycles of one frame; all engines and the DRAM see the same clock, so a request
enters the DRAM when it is made. Cost: some 20 million cycles a processor second; a frame of 5 M Gaussians has a few million.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from splatree.errors import SplatreeError
from splatree.hardware.config import Machine
from splatree.hardware.engines import Bounds, bounds_of, work_of
from splatree.hardware.order import visits_of
from splatree.hardware.trace import FrameTrace
from splatree.kernels.cpu import _core

__all__ = ["DeadlockError", "Fifo", "FrameTime", "Span", "Unit", "simulate_frame"]

STREAMS = ("records", "levels", "geometry", "color", "projected", "pairs", "lists", "splats", "frame")
"""What moves between the chip and its DRAM: records of clusters, of levels, columns of steps 1 and 2; projected records and lists
written; lists and projected records read; the picture written."""

UNITS = ("identification", "selection", "step1", "step2", "distribution", "sort", "blend")
"""Engines, in the order of the data."""


class DeadlockError(SplatreeError):
    """A simulation in which nothing moves any more; the message has the state of each engine."""


@dataclass(frozen=True)
class Unit:
    """What an engine did in each cycle of a frame."""

    busy: int
    """Cycles in which it worked."""
    stalled_on_input: int
    """Cycles in which it waited for data."""
    stalled_on_output: int
    """Cycles in which it waited for room."""
    idle: int
    """Cycles in which it had nothing left to do."""
    first_start: int
    """Cycle of its first work; −1: it had none."""
    last_end: int
    """Cycle of its last."""
    items: int
    """Clusters, Gaussians or tiles that passed."""


@dataclass(frozen=True)
class Fifo:
    """A queue between two engines."""

    pushes: int
    """Items that went in."""
    pops: int
    """Items that came out."""
    occupancy: int
    """Items in it, added up over all cycles."""
    waited: int
    """Cycles that items waited, added up."""
    most: int
    """Most items at once."""


@dataclass(frozen=True)
class Span:
    """A stretch of work, for time lines."""

    unit: str
    """Engine."""
    begin: int
    """First cycle."""
    end: int
    """Cycle after the last."""
    items: int
    """Gaussians or tiles."""


@dataclass(frozen=True)
class FrameTime:
    """A frame on a machine."""

    machine: Machine
    """The machine."""
    cycles: int
    """Cycles of the frame; where front and back end overlap, those from one frame to the next."""
    front_cycles: int
    """Cycles until the last list is written."""
    units: dict[str, Unit]
    """What each engine did."""
    records: Fifo
    """Queue of clusters in front of the identification."""
    selected: Fifo
    """Queue of kept clusters in front of step 1."""
    bytes: dict[str, int]
    """Bytes of each stream."""
    dram_busy: int
    """Cycles in which the DRAM moved data."""
    activations: int
    """Rows opened in the DRAM."""
    row_hit_rate: float
    """Share of lines that found their row open."""
    bounds: Bounds
    """Least cycles, by what bounds them."""
    num_walked: int
    """Rows that the selection of levels looked at."""
    num_rows: int
    """Gaussians read in step 1."""
    num_survivors: int
    """Gaussians of step 2."""
    num_pairs: int
    """Pairs of splat and tile."""
    num_evaluations: int
    """Evaluations of a splat at a pixel."""
    cache_hit_rate: float
    """Share of list entries whose projected record was in the cache."""
    spans: tuple[Span, ...]
    """Stretches of work of steps 1 and 2 and of the renderers."""

    @property
    def milliseconds(self) -> float:
        """Time of the frame."""
        return self.cycles / self.machine.clock_mhz / 1e3

    @property
    def front_milliseconds(self) -> float:
        """Time of the front end: steps 0 to 2 and distribution."""
        return self.front_cycles / self.machine.clock_mhz / 1e3

    @property
    def fps(self) -> float:
        """Frames a second."""
        return 1e3 / self.milliseconds if self.cycles else 0.0

    @property
    def total_bytes(self) -> int:
        """Bytes between chip and DRAM."""
        return sum(self.bytes.values())


def simulate_frame(machine: Machine, traces: Sequence[FrameTrace], frame: int = 0) -> FrameTime:
    """Step a machine through one of several frames of a scene.

    Args:
        machine: the accelerator.
        traces: frames of one scene in the order in which they are seen; the orders `frequency` and `previous-frame` learn
            from the others.
        frame: which of them to simulate.

    Returns:
        Cycles, bytes and what each engine did.

    Raises:
        DeadlockError: nothing moves any more; the message has the state of each engine.
    """
    trace = traces[frame]
    work = work_of(machine, trace, visits_of(machine.order, traces, frame))
    found = _core.simulate_frame(work.settings, work.clusters, work.tiles)
    if found["deadlock"]:
        raise DeadlockError(f"simulate: nothing moves any more on {machine.name!r}: {found['deadlock']}")
    lines: dict[str, int] = found["lines"]
    line_bytes = machine.dram.line_bytes
    hits, opened = found["row_hits"], found["activations"]
    return FrameTime(
        machine=machine,
        cycles=found["cycles"],
        front_cycles=found["front_cycles"],
        units={name: Unit(**found["units"][name]) for name in UNITS},
        records=Fifo(**found["records"]),
        selected=Fifo(**found["selected"]),
        bytes={name: lines[name] * line_bytes for name in STREAMS},
        dram_busy=found["dram_busy"],
        activations=opened,
        row_hit_rate=max(0.0, 1 - opened / max(sum(lines.values()), 1)) if hits else 0.0,
        bounds=bounds_of(machine, work, lines),
        num_walked=found["units"]["selection"]["items"],
        num_rows=found["rows_in"],
        num_survivors=found["survivors_out"],
        num_pairs=found["pairs_out"],
        num_evaluations=work.evaluations,
        cache_hit_rate=1 - work.cache_misses / max(work.cache_accesses, 1),
        spans=tuple(Span(*span) for span in found["spans"]),
    )
