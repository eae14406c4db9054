"""Morton codes: points along a Z-curve, so that neighbours in a file are mostly neighbours in space."""

from dataclasses import dataclass

import numpy as np

from splatree.shapes import Array

__all__ = ["MortonFrame", "frame_of_sample", "morton_codes", "morton_frame", "morton_sample"]

BITS = 21
"""Bits an axis: 3 × 21 fit in 64."""

SAMPLE = 1 << 16
"""Points, fewer than so many, of which the grid is found."""

_ROWS_AT_ONCE = 1 << 13
"""What lies between points and codes then stays in the first caches."""


@dataclass(frozen=True)
class MortonFrame:
    """Where the grid of a scene's Morton codes lies."""

    low: tuple[float, float, float]
    """Its least corner, world units."""
    side: float
    """Its side, world units."""


def morton_sample(num_points: int) -> slice:
    """The points that `morton_frame` looks at."""
    return slice(0, None, num_points // SAMPLE + 1)


def morton_frame(points: Array) -> MortonFrame:
    """The grid for points (n 3): it spans the middle 99 % of a sample of them along each axis.

    What lies outside shares the outermost cells, so that a few far outliers do not cost the rest its resolution.
    """
    return frame_of_sample(points[morton_sample(len(points))])


def frame_of_sample(sample: Array) -> MortonFrame:
    """The grid for points of which `morton_sample` has taken these."""
    if len(sample) == 0:
        return MortonFrame((0.0, 0.0, 0.0), 1.0)
    sample = sample.astype(np.float64)
    low, high = np.quantile(sample, 0.005, axis=0), np.quantile(sample, 0.995, axis=0)
    return MortonFrame((float(low[0]), float(low[1]), float(low[2])), max(float(np.max(high - low)), 1e-300))


def morton_codes(points: Array, frame: MortonFrame | None = None) -> Array:
    """Code of each point (n 3), uint64, on a grid of 2²¹ cells a side; ``frame`` None: the grid of `morton_frame`."""
    n = len(points)
    frame = frame or morton_frame(points)
    low, side = np.asarray(frame.low, np.float64), np.float64(frame.side)  # float32 points are widened
    codes = np.zeros(n, np.uint64)
    cells_max = 2.0**BITS - 1
    for begin in range(0, n, _ROWS_AT_ONCE):
        rows = slice(begin, begin + _ROWS_AT_ONCE)
        for axis in range(3):
            cells = np.clip((points[rows, axis] - low[axis]) * (cells_max / side), 0.0, cells_max).astype(np.uint64)
            codes[rows] |= _spread(cells) << np.uint64(2 - axis)
    return codes


def _spread(bits: Array) -> Array:
    """Each of the low 21 bits three places apart."""
    for shift, mask in (
        (32, 0x001F00000000FFFF),
        (16, 0x001F0000FF0000FF),
        (8, 0x100F00F00F00F00F),
        (4, 0x10C30C30C30C30C3),
        (2, 0x1249249249249249),
    ):
        bits = (bits | (bits << np.uint64(shift))) & np.uint64(mask)
    return bits
