"""Bands of distance, in each of which one depth of the tree is drawn: for baselines that choose by distance (baselines.py)."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from splatree.kernels.cpu.frame import baselines as cpu
from splatree.scene.cameras import Camera
from splatree.scene.scene import Scene
from splatree.scene.tree import GaussianTree
from splatree.shapes import Array, Bool, UInt8

__all__ = ["Bands", "centres_of", "drawn_alone", "flod_bands", "octree_bands"]

OCTREE_QUANTILE = 0.999
"""Share of the points nearer than a camera's largest distance, and farther than its smallest (Octree-GS, `set_level`)."""
SAMPLE = 100_000
"""Leaves of which distances are taken, evenly spread over the rows."""


@dataclass(frozen=True, eq=False)
class Bands:
    """Depths of the tree by distance."""

    edges_of: Callable[[Camera], Array]
    """Distances, ascending, at which bands meet."""
    depths: Array
    """Depth drawn in each band, from the nearest."""

    @property
    def num_bytes(self) -> int:
        """Beside the tree."""
        return 4 * (2 * len(self.depths) - 1)

    def flags(self, scene: Scene, camera: Camera, eye: Array, threads: int) -> UInt8[Array, "n"]:
        """Where each row lies to the depth of its band."""
        edges = self.edges_of(camera)
        return cpu.depth_flags(scene.gaussians, scene.tree, eye, edges, self.depths, threads=threads)


def drawn_alone(tree: GaussianTree, flags: Array) -> Bool[Array, "n"]:
    """Rows at the depth of their band, and leaves above it, whatever is drawn above or below them."""
    return np.asarray((flags == 1) | ((flags == 0) & tree.is_leaf))


def octree_bands(scene: Scene, cameras: Sequence[Camera], fork: float) -> Bands:
    """Level L = log_fork(d_std / d), rounded, 0 to levels − 1; d_std and the levels from the distances of cameras to points."""
    leaves = np.flatnonzero(scene.tree.is_leaf)
    if len(leaves) == 0:
        return Bands(lambda camera: np.zeros(0), np.zeros(1, int))
    points = scene.gaussians.means[leaves[:: max(1, len(leaves) // SAMPLE)]]
    shares = [1 - OCTREE_QUANTILE, OCTREE_QUANTILE]
    spans = np.array([np.quantile(np.linalg.norm(points - c.position, axis=1), shares) for c in cameras])
    nearest, farthest = np.quantile(spans, shares)
    steps = np.log(farthest / max(nearest, farthest * 2.0**-20)) / np.log(fork)
    levels = min(round(float(steps)) + 1, scene.tree.num_levels)
    finer = np.arange(levels - 1, 0, -1)
    edges = farthest * fork ** (0.5 - finer)
    depths = scene.tree.num_levels - levels + np.arange(levels - 1, -1, -1)
    return Bands(lambda camera: edges, depths)


def flod_bands(scene: Scene, num_bands: int, band_px: float) -> Bands:
    """A level begins at min(fx, fy) s / γ, s the standard deviation of its median Gaussian."""
    tree = scene.tree
    deepest = max(tree.num_levels - 1, 0)
    depths = np.unique(np.linspace(0, deepest, min(num_bands, deepest + 1)).round().astype(int))[::-1]
    largest = scene.gaussians.log_scales.max(axis=1)
    medians = np.array([np.median(largest[tree.depth == depth]) for depth in depths[1:]], np.float64)
    slopes = np.exp(np.maximum.accumulate(medians)) / band_px  # a distance for each px of the focal length
    return Bands(lambda camera: min(camera.K[0, 0], camera.K[1, 1]) * slopes, depths)


def centres_of(points: Array, count: int) -> Array:
    """Centres of at most ``count`` groups: the farthest points from each other to begin with, then ten rounds of Lloyd."""
    centres = [points[0]]
    while len(centres) < min(count, len(np.unique(points, axis=0))):
        distances = np.linalg.norm(points[:, None] - np.array(centres), axis=2).min(axis=1)
        centres.append(points[int(np.argmax(distances))])
    found = np.array(centres)
    for _ in range(10):
        nearest = np.linalg.norm(points[:, None] - found, axis=2).argmin(axis=1)
        found = np.array([points[nearest == i].mean(axis=0) for i in range(len(found))])
    return found
