"""Spheres and boxes of clusters: glue over spheres.cpp; kernels/reference/spheres.py is the definition."""

import numpy as np

from splatree.kernels.cpu import _core
from splatree.scene.clusters import ClusterIndex
from splatree.scene.gaussians import Gaussians
from splatree.shapes import Array, Float32, Int32

__all__ = ["bound_clusters"]


def bound_clusters(
    gaussians: Gaussians, start: Int32[Array, "c+1"], centers: Float32[Array, "c 3"], *, threads: int = 0
) -> ClusterIndex:
    """Spheres and boxes around the rows of each cluster; ``start`` ends with the number of rows."""
    # The kernel fills the arrays of the struct, before anyone else has it.
    radii = [np.empty(len(centers), np.float32) for _ in range(3)]
    boxes = [np.empty((len(centers), 3), np.float32) for _ in range(2)]
    clusters = ClusterIndex(start, centers, *radii, *boxes)
    _core.bound_spheres(gaussians, clusters, threads)
    return clusters
