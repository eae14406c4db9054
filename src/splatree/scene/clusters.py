"""Clusters of Gaussians: runs of consecutive rows with a sphere around each, and what a step of K-means leaves."""

from dataclasses import dataclass

from splatree.shapes import Array, Float32, Float64, Int32, Int64, check_fields


@dataclass(frozen=True, eq=False)
class Assignment:
    """The nearest centre of each point."""

    labels: Int32[Array, "n"]
    """Index of the centre; of equally near ones the first."""
    squared_distances: Float32[Array, "n"]
    """Squared distance to it."""
    sums: Float64[Array, "c 3"]
    """Sum of the points of each centre."""
    counts: Int64[Array, "c"]
    """Number of the points of each centre."""

    def __post_init__(self) -> None:
        check_fields(self)

    @property
    def inertia(self) -> float:
        """Sum of the squared distances, which K-means makes small."""
        return float(self.squared_distances.sum(dtype="float64"))
