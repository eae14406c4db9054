"""What merging has to know of the roots of a tree to go on where an earlier build stopped."""

from dataclasses import dataclass

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
