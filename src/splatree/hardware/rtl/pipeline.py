"""Registers of a pipeline, placed by what they hold: values that meet in a step are delayed until they are of one cycle."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from amaranth import Module, Signal

__all__ = ["Pipeline", "Value"]


@dataclass(frozen=True, eq=False)
class Value:
    """A signal, and how many cycles after its input it is there."""

    signal: Any
    stage: int


class Pipeline:
    """A pipeline that moves as a whole: every register holds what it has unless ``advances``."""

    def __init__(self, m: Module, advances: Signal) -> None:
        self._m, self._advances = m, advances
        self._next: dict[Value, Value] = {}
        self.num_registers = 0

    def step(self, compute: Callable[..., Any], *values: Value) -> Value:
        """What ``compute`` makes of the values' signals, a cycle after the last of them is there."""
        stage = max(value.stage for value in values)
        result = compute(*(self.at(value, stage) for value in values))
        return Value(self._register(result), stage + 1)

    def at(self, value: Value, stage: int) -> Any:
        """The signal, delayed to a stage."""
        while value.stage < stage:
            if value not in self._next:
                self._next[value] = Value(self._register(value.signal), value.stage + 1)
            value = self._next[value]
        return value.signal

    def _register(self, result: Any) -> Signal:
        register = Signal(result.shape(), name=f"register_{self.num_registers}")
        self.num_registers += 1
        with self._m.If(self._advances):
            self._m.d.sync += register.eq(result)
        return register
