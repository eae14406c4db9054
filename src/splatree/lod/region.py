"""A box of space, and the part of a scene that is known around it.

A box is half-open. Boxes that tile space hold each point once. Sides may be infinite, so that outliers lie in some box, too.
"""

from dataclasses import dataclass

import numpy as np

from splatree.errors import InputError
from splatree.shapes import Array, Bool, Float64

__all__ = ["EVERYWHERE", "Box", "Region"]

ROUNDING = 1e-6
"""Lengths are taken as so much longer, relative to them: far above what sums in float64 lose, far below what costs anything."""

FLOAT32_STEP = 2.0**-22
"""Two last bits of a float32, relative to it: a merged mean is rounded by less."""


@dataclass(frozen=True)
class Box:
    """All points p with ``low`` ≤ p < ``high``."""

    low: tuple[float, float, float]
    """Smallest coordinates, world units; −∞ where there is no side."""
    high: tuple[float, float, float]
    """Where it ends, world units; ∞ where there is no side."""

    def distances(self, points: Array) -> Float64[Array, "n"]:
        """Distance of each point (n 3) to the box; 0 inside."""
        squares = np.zeros(len(points))
        for axis, (low, high) in enumerate(zip(self.low, self.high, strict=True)):
            coordinates = points[:, axis].astype(np.float64)
            outside = np.maximum(np.maximum(low - coordinates, coordinates - high), 0)
            squares += outside * outside
        return np.sqrt(squares)

    def depths(self, points: Array) -> Float64[Array, "n"]:
        """Distance of each point (n 3) inside to the nearest side; infinity where there is none."""
        depths = np.full(len(points), np.inf)
        for axis, (low, high) in enumerate(zip(self.low, self.high, strict=True)):
            coordinates = points[:, axis].astype(np.float64)
            np.minimum(depths, np.minimum(coordinates - low, high - coordinates), out=depths)
        return depths

    def gaps(self, low: Array, high: Array) -> Float64[Array, "b"]:
        """Distance of the box to each of other boxes with the given corners (b 3)."""
        outside = np.maximum(np.maximum(np.asarray(self.low) - high, low - np.asarray(self.high)), 0)
        return np.asarray(np.sqrt(np.einsum("ij,ij->i", outside, outside)))

    def holds(self, points: Array) -> Bool[Array, "n"]:
        """Whether each point (n 3) is inside."""
        inside = np.ones(len(points), bool)
        for axis, (low, high) in enumerate(zip(self.low, self.high, strict=True)):
            inside &= (points[:, axis] >= low) & (points[:, axis] < high)
        return inside

    def halved(self, axis: int, at: float) -> tuple["Box", "Box"]:
        """The part below and the part above a plane across an axis."""
        low, high = list(self.low), list(self.high)
        low[axis], high[axis] = at, at
        return Box(self.low, (high[0], high[1], high[2])), Box((low[0], low[1], low[2]), self.high)


EVERYWHERE = Box((-np.inf,) * 3, (np.inf,) * 3)
"""All of space."""


@dataclass(frozen=True)
class Region:
    """The part of a scene around a box in which all nodes of a level are known."""

    box: Box
    """The box."""
    reach: float
    """Each node whose mean is at most this far from the box is known, and no other, world units."""

    def __post_init__(self) -> None:
        if not self.reach >= 0:
            raise InputError(f"Region.reach: found {self.reach}, wanted 0 or more, world units")

    @property
    def slack(self) -> float:
        """What rounding a mean to float32 can move it towards the box, world units.

        A mean within reach has no coordinate farther from the box than the reach, so it is as large as a finite side and the
        reach together.
        """
        sides = [abs(side) for side in (*self.box.low, *self.box.high) if np.isfinite(side)]
        if not sides or not np.isfinite(self.reach):
            return 0.0
        return 3**0.5 * FLOAT32_STEP * (max(sides) + self.reach)
