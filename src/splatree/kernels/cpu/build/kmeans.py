"""A step of K-means: glue over kmeans.cpp and nearest.cpp; kernels/reference/kmeans.py is the definition."""

from collections.abc import Callable

import numpy as np

from splatree.kernels.cpu import _core
from splatree.scene.clusters import Assignment
from splatree.shapes import Array, Float32

__all__ = ["assign", "steps_of"]


def assign(points: Float32[Array, "n 3"], centers: Float32[Array, "c 3"], *, threads: int = 0) -> Assignment:
    """The nearest centre of each point; fast if neighbours in the list are near in space."""
    return steps_of(points, threads=threads)(centers)


def steps_of(
    points: Float32[Array, "n 3"], *, threads: int = 0, zeros: Callable[[tuple[int, ...], type], Array] = np.zeros
) -> Callable[[Array], Assignment]:
    """`assign` again and again; each step overwrites the labels and the distances of the one before, which ``zeros`` makes."""
    labels, squared_distances = zeros((len(points),), np.int32), zeros((len(points),), np.float32)

    def step(centers: Float32[Array, "c 3"]) -> Assignment:
        found = Assignment(labels, squared_distances, np.empty((len(centers), 3)), np.empty(len(centers), np.int64))
        _core.kmeans(points, centers, found.labels, found.squared_distances, found.sums, found.counts, threads)
        return found

    return step
