"""Spheres and boxes of clusters around given centres, by definition (scene/clusters.py: `ClusterIndex`)."""

import numpy as np

from splatree.constants import ALPHA_THRESHOLD, SIGMAS
from splatree.maths.covariance import axes_from_gaussians
from splatree.scene.clusters import ClusterIndex
from splatree.scene.gaussians import Gaussians
from splatree.shapes import Array, Float32, Int32

__all__ = ["bound_clusters"]


def bound_clusters(
    gaussians: Gaussians, start: Int32[Array, "c+1"], centers: Float32[Array, "c 3"], *, threads: int = 0
) -> ClusterIndex:
    """Spheres and boxes around the rows of each cluster; ``threads`` is not used."""
    of_row = np.repeat(np.arange(len(centers)), np.diff(start))
    with np.errstate(invalid="ignore", over="ignore"):
        distances = np.linalg.norm(gaussians.means.astype(np.float64) - centers[of_row].astype(np.float64), axis=1)
        sigmas = gaussians.scales().max(axis=1)
        opacities = gaussians.opacities()
        reach = np.sqrt(2 * np.log(np.maximum(opacities / ALPHA_THRESHOLD, 1)))
        drawn = opacities >= ALPHA_THRESHOLD
        footprints = np.where(drawn, distances + reach * sigmas, 0.0)
        columns = (distances + SIGMAS * sigmas, distances, footprints)
        largest = (np.fmax.reduceat(values, start[:-1]) for values in columns)  # NaN is never drawn and passed over
        radii = [_rounded_up(values) for values in largest]
        axes = axes_from_gaussians(gaussians.quats, gaussians.log_scales)  # [n 3 3]: R S
        spreads = reach[:, None] * np.sqrt((axes * axes).sum(axis=2))  # k √Σ_ii
        low, high = (
            np.where(drawn[:, None], gaussians.means + spread, centers[of_row]) for spread in (-spreads, spreads)
        )
        boxes = [
            -_rounded_up(-np.fmin(np.fmin.reduceat(low, start[:-1]), centers)),
            _rounded_up(np.fmax(np.fmax.reduceat(high, start[:-1]), centers)),
        ]
    return ClusterIndex(start, centers, *radii, *boxes)


def _rounded_up(values: Array) -> Float32[Array, "..."]:
    nearest = values.astype(np.float32)
    return np.where(nearest < values, np.nextafter(nearest, np.float32(np.inf)), nearest)
