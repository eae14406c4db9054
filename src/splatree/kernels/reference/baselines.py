"""Rules of published methods by definition; lod/baselines.py says where they are from.

box      size(v) = longest side of the box around v and all below it / its distance from the eye, ∞ inside;
         small(v) ⇔ size(v) < limit                                                                            (H3DGS)
depth    the distance of v's mean from the eye lies in a band, and the band asks for a depth             (Octree-GS, FLoD)
"""

import numpy as np

from splatree.constants import SIGMAS
from splatree.kernels.reference.select import shadowed
from splatree.scene.gaussians import Gaussians
from splatree.scene.tree import GaussianTree
from splatree.shapes import Array, Float32, Int32, UInt8

__all__ = ["depth_flags", "first_stops", "nested_boxes", "small_boxes"]


def nested_boxes(gaussians: Gaussians, tree: GaussianTree) -> tuple[Float32[Array, "n 3"], Float32[Array, "n 3"]]:
    """Lower and upper corners of the boxes around means ± 3 σ of each row and all below it, σ the row's largest."""
    reach = SIGMAS * np.exp(gaussians.log_scales.max(axis=1, keepdims=True))
    lower, upper = gaussians.means - reach, gaussians.means + reach
    subtrees = [slice(i, end) for i, end in enumerate(tree.subtree_end)]
    nested = [lower[s].min(axis=0) for s in subtrees], [upper[s].max(axis=0) for s in subtrees]
    return np.reshape(nested[0], (-1, 3)), np.reshape(nested[1], (-1, 3))


def small_boxes(lower: Array, upper: Array, eye: Array, limit: float, *, threads: int = 0) -> UInt8[Array, "n"]:
    """1 where the longest side of a box is less than ``limit`` × its distance from the eye, else 0."""
    lower, upper = lower.astype(np.float64), upper.astype(np.float64)
    distances = np.linalg.norm(np.maximum(0, np.maximum(lower - eye, eye - upper)), axis=1)
    return np.asarray((upper - lower).max(axis=1, initial=0) < limit * distances, np.uint8)


def depth_flags(
    gaussians: Gaussians, tree: GaussianTree, eye: Array, edges: Array, depths: Array, *, threads: int = 0
) -> UInt8[Array, "n"]:
    """0, 1, 2 where the row is above, at, below the depth of its band: ``depths[b]`` from ``edges[b − 1]`` to ``edges[b]``."""
    distances = np.linalg.norm(gaussians.means - np.asarray(eye, np.float64), axis=1)
    wanted = np.asarray(depths)[np.searchsorted(edges, distances, side="right")]
    return np.asarray(1 + np.sign(tree.depth.astype(int) - wanted), np.uint8)


def first_stops(tree: GaussianTree, flags: UInt8[Array, "n"], least: int) -> Int32[Array, "v"]:
    """The first row on each path from a root that is a leaf or has a flag of at least ``least``."""
    stops = flags >= least
    first = (stops | tree.is_leaf) & ~shadowed(stops & ~tree.is_leaf, tree.subtree_end)
    return np.flatnonzero(first).astype(np.int32)
