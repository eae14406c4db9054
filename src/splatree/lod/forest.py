"""Nodes and families as levels grow, before they are put into the order of rows (lod/order.py)."""

from dataclasses import dataclass, field

from splatree.lod.order import Level
from splatree.scene.gaussians import Gaussians
from splatree.shapes import Array

__all__ = ["Forest"]


@dataclass(frozen=True, eq=False)
class Forest:
    """Nodes by number: leaves along the Morton curve, then each level's new ones."""

    leaf_from_node: Array
    """Row of the input for each of the first n nodes."""
    columns: list[Gaussians]
    """Leaves, then each level's new nodes, harmonics to degree 0."""
    weights: list[Array]
    """Summed weights, in the same pieces."""
    levels: list[Level]
    """Families."""
    roots: Array
    """Nodes without a parent, in order."""
    counts: list[int]
    """Nodes left after each level."""
    steps: list[float]
    """Radius of each level, or the width of its pixels, world units."""
    extents: list[float] = field(default_factory=list)
    """Extent of the nodes of each level; empty: of balls that hold what is below them."""
