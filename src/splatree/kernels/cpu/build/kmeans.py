"""A step of K-means: glue over kmeans.cpp and nearest.cpp; kernels/reference/kmeans.py is the definition."""

import numpy as np

from splatree.kernels.cpu import _core
from splatree.scene.clusters import Assignment
from splatree.shapes import Array, Float32

__all__ = ["assign"]


def assign(points: Float32[Array, "n 3"], centers: Float32[Array, "c 3"], *, threads: int = 0) -> Assignment:
    """The nearest centre of each point; fast if neighbours in the list are near in space."""
    n, c = len(points), len(centers)
    found = Assignment(np.empty(n, np.int32), np.empty(n, np.float32), np.empty((c, 3)), np.empty(c, np.int64))
    _core.kmeans(points, centers, found.labels, found.squared_distances, found.sums, found.counts, threads)
    return found
