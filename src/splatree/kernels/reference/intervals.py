"""The division of ascending numbers into intervals with the least squared error: K-means in one dimension, exactly."""

import numpy as np

from splatree.shapes import Array, Float64, Int64


def best_intervals(x: Float64[Array, "n"], weights: Float64[Array, "n"], count: int) -> Int64[Array, "c+1"]:
    """Where the best ``count`` ≤ n intervals of ascending ``x`` begin, and n."""
    n = len(x)
    error = np.full((n + 1, n + 1), np.inf)  # of the interval i … j − 1
    for i in range(n):
        for j in range(i + 1, n + 1):
            mean = np.average(x[i:j], weights=weights[i:j])
            error[i, j] = np.sum(weights[i:j] * (x[i:j] - mean) ** 2)
    least, starts = error[0], []
    for _ in range(count - 1):
        sums = least[:, None] + error
        starts.append(sums.argmin(axis=0))
        least = sums.min(axis=0)
    cuts = [n]
    for start in reversed(starts):
        cuts.append(int(start[cuts[-1]]))
    return np.array([0, *reversed(cuts)], np.int64)
