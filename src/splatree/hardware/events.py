"""The front end once more, from event to event instead of cycle to cycle: an independent check of the core, in plain Python.

Between two events everything moves at a constant rate: the identification takes what records it is given, each engine its lanes,
and the DRAM's bandwidth (L0) is shared evenly by the streams that wait, records of clusters first. An event is the moment when
the first of them is through: a cluster is identified, a piece has arrived or is computed, a pipeline has let it out. Nothing is
shared with the core but the counts of `engines.work_of`.
"""

import heapq
import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from splatree.hardware.engines import Work

__all__ = ["front_cycles"]

_NOTHING = 1e-7
"""What is left of a piece below this is rounding."""


@dataclass
class _Piece:
    rows: float
    survivors: float
    pairs: float
    first_row: float
    span_rows: float
    cluster: int = -1

    def without(self, first: "_Piece") -> "_Piece":
        """What follows the first part."""
        rows, survivors, pairs = self.rows - first.rows, self.survivors - first.survivors, self.pairs - first.pairs
        begin, span = self.first_row + first.span_rows, self.span_rows - first.span_rows
        return _Piece(rows, survivors, pairs, begin, span, self.cluster)


@dataclass
class _Half:
    pieces: list[_Piece] = field(default_factory=list)
    rows: float = 0.0
    is_full: bool = False
    unarrived: int = 0


class _Engine:
    """Fills halves from a stream and computes them; what is computed leaves after the pipeline's latency."""

    QUEUE = 64

    def __init__(self, numbers: dict[str, Any], bytes_of: Callable[[_Piece], float]) -> None:
        self.lanes, self.latency, self.capacity = numbers["lanes"], numbers["latency"], numbers["capacity"]
        self.bytes_of = bytes_of
        self.free = [_Half() for _ in range(numbers["halves"])]
        self.filling: _Half | None = self.free.pop()
        self.full: deque[_Half] = deque()
        self.queue: deque[_Piece] = deque()
        self.transfers: deque[tuple[list[float], _Half]] = deque()
        self.computing: _Half | None = None
        self.left = 0.0
        self.closed = False

    @property
    def is_done(self) -> bool:
        filled = self.filling is not None and self.filling.pieces
        return self.closed and not (self.queue or filled or self.full or self.computing)

    def fill(self) -> None:
        while self.filling is not None:
            half = self.filling
            if self.queue and not half.is_full:
                piece = self.queue.popleft()
                taken = min(piece.rows, self.capacity - half.rows)
                share = taken / piece.rows
                survivors, pairs, span = (share * n for n in (piece.survivors, piece.pairs, piece.span_rows))
                part = _Piece(taken, survivors, pairs, piece.first_row, span, piece.cluster)
                if share < 1:
                    self.queue.appendleft(piece.without(part))
                half.pieces.append(part)
                half.rows += taken
                half.unarrived += 1
                self.transfers.append(([self.bytes_of(part)], half))
            half.is_full = half.rows >= self.capacity - _NOTHING or (
                self.closed and not self.queue and bool(half.pieces)
            )
            if half.is_full:
                self.full.append(half)
                self.filling = self.free.pop() if self.free else None
            elif not self.queue:
                return

    def start(self) -> None:
        if self.computing is None and self.full and self.full[0].unarrived == 0:
            self.computing = self.full.popleft()
            self.left = self.computing.pieces[0].rows

    def next_piece(self) -> _Piece:
        """The piece that has just been computed; frees the half after its last."""
        assert self.computing is not None
        piece = self.computing.pieces.pop(0)
        if self.computing.pieces:
            self.left = self.computing.pieces[0].rows
        else:
            self.computing = None
            if self.filling is None:
                self.filling = _Half()
            else:
                self.free.append(_Half())
        return piece


class _Front:
    def __init__(self, work: Work) -> None:
        self.s, self.columns = work.settings, work.clusters
        self.line = self.s["dram"]["line_bytes"]
        self.levels = _Engine(self.s["levels"], lambda piece: piece.span_rows * self.line)
        self.step1 = _Engine(self.s["geometry"], self._geometry)
        self.walked = 0.0  # rows of the cluster that is being walked
        self.step2 = _Engine(self.s["color"], self._colors)
        self.visits = self.columns["visits"].tolist()
        self.visited = 0.0  # records identified, with the share of the next
        self.selected: deque[int] = deque()
        self.timers: list[tuple[float, int, Callable[[], None]]] = []
        self.count = 0
        self.now = self.written = self.to_write = self.backlog = 0.0
        self.in_pipes = [0, 0, 0, 0]  # identification, step 1, step 2, selection of levels

    def run(self) -> float:
        while True:
            self._advance_states()
            if self._is_done():
                return self.now
            rates = self._rates()
            step = min(
                [left / rate for left, rate in self._remaining(rates) if rate > 0]
                + [self.timers[0][0] - self.now if self.timers else float("inf")]
            )
            assert step < float("inf"), "nothing moves"
            self._move(rates, step)

    def _run(self, numbers: dict[str, Any], first: float, rows: float) -> float:
        begin = numbers["base"] + first * numbers["row_bytes"]
        return float(
            ((begin + rows * numbers["row_bytes"] + self.line - 1) // self.line - begin // self.line) * self.line
        )

    @property
    def first(self) -> _Engine:
        """What kept clusters go to."""
        return self.levels if self.s["selects_levels"] else self.step1

    def _touched(self, size: int) -> float:
        """Lines of a row, on average over where rows begin."""
        return float(1 + (size - math.gcd(size, self.line)) / self.line)

    def _geometry(self, piece: _Piece) -> float:
        size = self.s["geometry"]["row_bytes"]
        gathered = piece.rows * self._touched(size)
        if piece.rows >= piece.span_rows - _NOTHING or gathered >= piece.span_rows * size / self.line:
            return self._run(self.s["geometry"], piece.first_row, piece.span_rows)
        return float(gathered * self.line)

    def _colors(self, piece: _Piece) -> float:
        if piece.rows >= self.s["streamed_share"] * piece.span_rows:
            return self._run(self.s["color"], piece.first_row, piece.span_rows)
        return float(piece.rows * self._touched(self.s["color"]["row_bytes"]) * self.line)

    def _after(self, delay: float, action: Callable[[], None]) -> None:
        self.count += 1
        heapq.heappush(self.timers, (self.now + delay, self.count, action))

    def _piece_of(self, cluster: int) -> _Piece:
        names = ("rows", "survivors", "pairs", "first_row", "span_rows")
        rows, survivors, pairs, first_row, span_rows = (float(self.columns[name][cluster]) for name in names)
        return _Piece(rows, survivors, pairs, first_row, span_rows, cluster)

    def _enter(self, cluster: int) -> None:
        """A kept cluster goes to the engine that is first; the span of a walk is its lines."""
        if not self.s["selects_levels"]:
            self._push(self.step1, self._piece_of(cluster))
            return
        walked, lines = (float(self.columns[name][cluster]) for name in ("walked", "walk_lines"))
        self._push(self.levels, _Piece(walked, 0.0, 0.0, 0.0, lines, cluster))

    def _push(self, engine: _Engine, piece: _Piece) -> None:
        if piece.rows > _NOTHING:
            engine.queue.append(piece)

    def _advance_states(self) -> None:
        """Everything that takes no time."""
        while True:
            before = self._counts()
            while self.timers and self.timers[0][0] <= self.now + _NOTHING:
                heapq.heappop(self.timers)[2]()
            if not self.s["identifies"]:
                while self.visited < len(self.visits) and len(self.first.queue) < _Engine.QUEUE:
                    self._enter(self.visits[int(self.visited)])
                    self.visited += 1
            while self.selected and len(self.first.queue) < _Engine.QUEUE:
                self._enter(self.selected.popleft())
            self.first.closed = self.visited >= len(self.visits) and not self.selected and not self.in_pipes[0]
            if self.s["selects_levels"]:
                self.levels.fill()
                self.levels.start()
                self.step1.closed = self.levels.is_done and not self.in_pipes[3]
            self.step1.fill()
            self.step1.start()
            self.step2.closed = self.step1.is_done and not self.in_pipes[1]
            self.step2.fill()
            self.step2.start()
            if before == self._counts():
                return

    def _counts(self) -> tuple[int, ...]:
        engines = (self.levels, self.step1, self.step2)
        return len(self.selected), len(self.timers), *(len(engine.queue) for engine in engines)

    def _is_done(self) -> bool:
        return self.step2.is_done and not self.in_pipes[2] and self.backlog <= _NOTHING and self.to_write <= _NOTHING

    def _identifies(self) -> bool:
        in_pipeline = -(-self.s["latency"] // self.s["interval"])
        room = len(self.selected) + self.in_pipes[0] < self.s["selected_fifo"] + in_pipeline
        return self.s["identifies"] and self.visited < len(self.visits) and room

    def _rates(self) -> dict[str, float]:
        width = self.s["dram"]["bytes_per_cycle"]
        rates: dict[str, float] = {}
        if self._identifies():
            rates["identification"] = min(1 / self.s["interval"], width / self.s["record_bytes"])
            width -= rates["identification"] * self.s["record_bytes"]
        waiting = {
            "levels": self.levels.transfers,
            "geometry": self.step1.transfers,
            "color": self.step2.transfers,
            "write": self.to_write > _NOTHING,
        }
        active = [name for name, has in waiting.items() if has]
        rates |= {name: width / len(active) for name in active}
        if self.levels.computing and len(self.step1.queue) < _Engine.QUEUE:
            rates["selection"] = self.levels.lanes
        if self.step1.computing and len(self.step2.queue) < _Engine.QUEUE:
            rates["step1"] = self.step1.lanes
        if self.step2.computing and self.backlog <= self.s["pair_backlog"]:
            rates["step2"] = self.step2.lanes
        if self.backlog > _NOTHING:
            rates["distribution"] = self.s["pairs_per_cycle"]
        return rates

    def _remaining(self, rates: dict[str, float]) -> list[tuple[float, float]]:
        left = {
            "identification": 1 - self.visited % 1,
            "levels": self.levels.transfers[0][0][0] if self.levels.transfers else 0.0,
            "geometry": self.step1.transfers[0][0][0] if self.step1.transfers else 0.0,
            "color": self.step2.transfers[0][0][0] if self.step2.transfers else 0.0,
            "write": self.to_write,
            "selection": self.levels.left,
            "step1": self.step1.left,
            "step2": self.step2.left,
            "distribution": self.backlog,
        }
        return [(left[name], rate) for name, rate in rates.items()]

    def _move(self, rates: dict[str, float], step: float) -> None:
        self.now += step
        if "identification" in rates:
            before = int(self.visited + _NOTHING)
            self.visited += rates["identification"] * step
            if int(self.visited + _NOTHING) > before:
                self.visited = float(before + 1)
                self._identify(self.visits[before])
        self.to_write = max(0.0, self.to_write - rates.get("write", 0.0) * step)
        if "distribution" in rates:
            pairs = min(self.backlog, rates["distribution"] * step)
            self.backlog -= pairs
            self.to_write += pairs * self.s["list_lines_per_pair"] * self.line
        for engine, stream, compute, emit in (
            (self.levels, "levels", "selection", self._select),
            (self.step1, "geometry", "step1", self._pass_on),
            (self.step2, "color", "step2", self._write),
        ):
            self._transfer(engine, rates.get(stream, 0.0) * step)
            if compute in rates:
                engine.left -= rates[compute] * step
                if engine.left <= _NOTHING:
                    emit(engine.next_piece(), engine.latency)

    def _transfer(self, engine: _Engine, moved: float) -> None:
        if not engine.transfers:
            return
        remaining, half = engine.transfers[0]
        remaining[0] -= moved
        if remaining[0] <= _NOTHING:
            engine.transfers.popleft()

            def arrive() -> None:
                half.unarrived -= 1

            self._after(self.s["dram"]["latency"], arrive)

    def _identify(self, cluster: int) -> None:
        if cluster < 0:
            return
        self.in_pipes[0] += 1

        def select() -> None:
            self.in_pipes[0] -= 1
            self.selected.append(cluster)

        self._after(self.s["latency"], select)

    def _select(self, piece: _Piece, latency: float) -> None:
        self.in_pipes[3] += 1

        def emit() -> None:
            self.in_pipes[3] -= 1
            self.walked += piece.rows
            if self.walked >= self.columns["walked"][piece.cluster] - _NOTHING:
                self.walked = 0.0
                self._push(self.step1, self._piece_of(piece.cluster))

        self._after(latency, emit)

    def _pass_on(self, piece: _Piece, latency: float) -> None:
        if piece.survivors <= _NOTHING:
            return
        self.in_pipes[1] += 1

        def emit() -> None:
            self.in_pipes[1] -= 1
            self.step2.queue.append(
                _Piece(piece.survivors, piece.survivors, piece.pairs, piece.first_row, piece.span_rows)
            )

        self._after(latency, emit)

    def _write(self, piece: _Piece, latency: float) -> None:
        self.in_pipes[2] += 1

        def emit() -> None:
            self.in_pipes[2] -= 1
            self.backlog += piece.pairs
            self.to_write += piece.rows * self.s["splat_bytes"]

        self._after(latency, emit)


def front_cycles(work: Work) -> float:
    """Cycles of the front end, from the start to the last list, with the DRAM of fidelity L0.

    Args:
        work: what `engines.work_of` makes of a machine and a trace.

    Returns:
        Cycles; within 1 % of the core's.
    """
    return _Front(work).run()
