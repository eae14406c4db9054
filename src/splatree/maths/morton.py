"""Morton codes: points along a Z-curve, so that neighbours in a file are mostly neighbours in space."""

import numpy as np

from splatree.shapes import Array

__all__ = ["morton_codes"]

BITS = 21
"""Bits an axis: 3 × 21 fit in 64."""

_ROWS_AT_ONCE = 1 << 13
"""What lies between points and codes then stays in the first caches."""


def morton_codes(points: Array) -> Array:
    """Code of each point (n 3), uint64, on a grid of 2²¹ cells along the scene's longest side.

    The grid spans the middle 99 % of the points along each axis; what lies outside shares the outermost cells, so that a few
    far outliers do not cost the rest its resolution.
    """
    n = len(points)
    if n == 0:
        return np.zeros(0, np.uint64)
    sample = points[:: n // 65536 + 1].astype(np.float64)
    low, high = np.quantile(sample, 0.005, axis=0), np.quantile(sample, 0.995, axis=0)
    side = max(float(np.max(high - low)), 1e-300)
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
