"""What merging has to know of the roots of a tree to go on where an earlier build stopped."""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from splatree.errors import ShapeError
from splatree.shapes import Array, Float32, Float64, Int32, Int64, UInt64, check_fields

__all__ = ["Roots"]


@dataclass(frozen=True, eq=False)
class Roots:
    """The state of growth at the roots of a tree, in their order.

    Rows of a scene hold rounded or merged values. Growth that goes on above them gives the same bits as growth that was never
    interrupted only if it knows the sums and ranks below.
    """

    weights: Float32[Array, "r"]
    """Weight of each root: the sum over its leaves, in units of e^``log_unit``."""
    visibilities: Float32[Array, "r"]
    """How much of each root is seen, 0 to 1; 1 where the rule does not ask."""
    reaches: Float64[Array, "r"]
    """Radius of the ball around each root that holds its subtree, world units, before it is rounded to the tree's extent."""
    codes: UInt64[Array, "r"]
    """Morton code of the leaf that each root's chain of representatives began with: ranks nodes among each other."""
    inputs: Int64[Array, "r"]
    """Row of that leaf in the input of the whole build: ranks equal codes."""
    num_sizes: int = 0
    """How many of the sizes of levels growth has gone through."""
    grown: Int32[Array, "r"] | None = None
    """How many of them each root has gone through: fewer where it waits for what is beyond the border of its part; None: all."""
    log_unit: float = 0.0
    """Logarithm of the weight that counts 1."""

    def __post_init__(self) -> None:
        check_fields(self)
        if not 0 <= self.num_sizes < 2**31:
            raise ShapeError(f"Roots.num_sizes: found {self.num_sizes}, wanted 0 or more")

    def __len__(self) -> int:
        return len(self.weights)

    def take(self, rows: Int64[Array, "n"]) -> "Roots":
        """The state of some of the roots."""
        return replace(self, **{name: column[rows] for name, column in self._columns().items()})

    @staticmethod
    def concatenate(states: Sequence["Roots"]) -> "Roots":
        """The state of all roots of one scene, one part after the other; at least one."""
        if any(state.grown is not None or state.num_sizes != states[0].num_sizes for state in states):
            states = [state if state.grown is not None else state._counted() for state in states]
        columns = [state._columns() for state in states]
        joined: dict[str, Any] = {name: np.concatenate([each[name] for each in columns]) for name in columns[0]}
        return replace(states[0], **joined, num_sizes=max(state.num_sizes for state in states))

    def _columns(self) -> dict[str, Any]:
        values = {f.name: getattr(self, f.name) for f in fields(self)}
        return {name: value for name, value in values.items() if isinstance(value, np.ndarray)}

    def _counted(self) -> "Roots":
        return replace(self, grown=np.full(len(self), self.num_sizes, np.int32))
