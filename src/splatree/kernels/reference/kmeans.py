"""A step of K-means (Lloyd 1982): the nearest centre of each point, by definition.

    label_i = argmin_j |p_i − c_j|²,   ties by the smaller j;   the sum and number of the points of each centre

The new centres are sums / counts. Cost: O(n · c).
"""

import numpy as np

from splatree.scene.clusters import Assignment
from splatree.shapes import Array, Float32

__all__ = ["assign"]


def assign(points: Float32[Array, "n 3"], centers: Float32[Array, "c 3"], *, threads: int = 0) -> Assignment:
    """The nearest centre of each point; ``threads`` is not used."""
    x, c = points.astype(np.float64), centers.astype(np.float64)
    labels, squared = np.zeros(len(x), np.int32), np.zeros(len(x), np.float32)
    for i, point in enumerate(x):
        distances = ((point - c) ** 2).sum(axis=1)
        labels[i] = distances.argmin()  # the first of equals
        squared[i] = distances[labels[i]]
    sums = np.zeros((len(c), 3))
    np.add.at(sums, labels, x)
    return Assignment(labels, squared, sums, np.bincount(labels, minlength=len(c)).astype(np.int64))
