"""The division of ascending numbers into intervals with the least squared error: K-means in one dimension, exactly."""

import numpy as np

from splatree.kernels.cpu import _core
from splatree.shapes import Array, Float64, Int64

__all__ = ["best_intervals"]


def best_intervals(x: Float64[Array, "n"], weights: Float64[Array, "n"], count: int) -> Int64[Array, "c+1"]:
    """Where the best ``count`` ≤ n intervals of ascending ``x`` begin, and n."""
    centred = x - x.mean()  # or the sums of squares would lose the differences of large numbers
    mass, moment, square = (np.concatenate([[0.0], np.cumsum(weights * centred**power)]) for power in (0, 1, 2))
    cuts = np.empty(count + 1, np.int64)
    _core.best_intervals(mass, moment, square, cuts)
    return cuts
