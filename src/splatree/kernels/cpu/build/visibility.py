"""Visibility on the processor: what ``reference/visibility.py`` defines, in float32, at once or of a scene that passes by."""

from dataclasses import dataclass

import numpy as np

from splatree.kernels.cpu import _core
from splatree.scene.gaussians import Gaussians
from splatree.shapes import Array, Float32, Float64, UInt32

__all__ = ["NUM_AXES", "Plane", "Sight", "depths_along", "measure_visibilities", "sighted_along", "steps_of_depths"]

NUM_AXES = 4
"""Axes along which a scene is looked at, both ways."""

SIGHTED = ("u", "v", "depth", "a", "b", "c", "half_u", "half_v", "opacity", "sum")
"""Columns of a splat as it is seen along an axis (``Sighted``), lengths in cells; the sum is of the squares of what is seen."""

MARGIN = 40
"""Cells that a row of the plane has besides its width (``SIGHT_MARGIN``)."""


@dataclass(frozen=True, eq=False)
class Sight:
    """The lengths by which a scene is looked at, decided for the whole of it."""

    middle: Float64[Array, "3"]
    """Where the middle of the plane is, world units."""
    cell: float
    """Edge of a cell of the plane, world units."""
    reach: float
    """Distance behind a Gaussian at which it hides e times less, world units; infinity: nothing is forgotten."""
    width: int
    """Cells of the plane along either side, a power of two of at least 64; it repeats itself."""

    def __post_init__(self) -> None:
        assert self.width >= 64 and self.width & (self.width - 1) == 0


def measure_visibilities(gaussians: Gaussians, sight: Sight, *, threads: int = 0) -> Float32[Array, "n"]:
    """What others leave to be seen of each Gaussian, 0 to 1."""
    visibilities = np.empty(len(gaussians), np.float32)
    _core.measure_visibilities(gaussians, sight, visibilities, threads)
    return visibilities


def depths_along(means: Float32[Array, "n 3"], sight: Sight, axis: int, *, threads: int = 0) -> Float32[Array, "n"]:
    """Depth of each mean along an axis, cells."""
    depths = np.empty(len(means), np.float32)
    _core.depths_along(means, sight, axis, depths, threads)
    return depths


def steps_of_depths(depths: Float32[Array, "n"], nearest: float, farthest: float) -> UInt32[Array, "n"]:
    """The step that each depth falls into, of 2²² from the nearest to the farthest: rows are looked at by it, ties by row."""
    steps = np.empty(len(depths), np.uint32)
    _core.steps_of_depths(depths, nearest, farthest, steps)
    return steps


def sighted_along(gaussians: Gaussians, sight: Sight, axis: int, *, threads: int = 0) -> Float32[Array, "n 10"]:
    """Each Gaussian as a splat along an axis, of which nothing is seen yet: ``Sighted`` in visibility.h."""
    splats = np.empty((len(gaussians), len(SIGHTED)), np.float32)
    _core.sighted_along(gaussians, sight, axis, splats, threads)
    return splats


class Plane:
    """The plane through which a scene is seen along an axis, while its splats pass by in the order of their depth."""

    def __init__(self, sight: Sight, *, backwards: bool) -> None:
        self.sight, self.backwards = sight, backwards
        self._passing = np.ones(sight.width * (sight.width + MARGIN), np.float32)
        self._depths = np.zeros(sight.width * (sight.width + MARGIN), np.float32)

    def look_on(self, splats: Float32[Array, "n 10"]) -> None:
        """Look at the next splats, by rising depth whichever way; adds the square of what is seen of each to its sum."""
        _core.see_through(splats, self.sight, self.backwards, self._passing, self._depths)


def plane_bytes(sight: Sight) -> int:
    """Memory of a plane."""
    return 2 * 4 * sight.width * (sight.width + MARGIN)


def visibilities_from(sums: Float32[Array, "a n"]) -> Float32[Array, "n"]:
    """What `measure_visibilities` makes of the sums along all axes."""
    total = np.zeros(sums.shape[1], np.float32)
    for along in sums:
        total += along
    return np.asarray(np.sqrt(total / np.float32(2 * NUM_AXES)))
