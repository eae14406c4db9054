"""Rules of published methods, all rows at once: glue over baselines.cpp; kernels/reference/baselines.py is the definition."""

import numpy as np

from splatree.constants import SIGMAS
from splatree.kernels.cpu import _core
from splatree.scene.gaussians import Gaussians
from splatree.scene.tree import GaussianTree
from splatree.shapes import Array, Float32, Int32, UInt8

__all__ = ["depth_flags", "first_stops", "nested_boxes", "small_boxes"]


def nested_boxes(gaussians: Gaussians, tree: GaussianTree) -> tuple[Float32[Array, "n 3"], Float32[Array, "n 3"]]:
    """Lower and upper corners of the boxes around means ± 3 σ of each row and all below it, σ the row's largest."""
    reach = SIGMAS * np.exp(gaussians.log_scales.max(axis=1, keepdims=True))
    lower, upper = gaussians.means - reach, gaussians.means + reach
    _core.nest_boxes(tree.depth, lower, upper)
    return lower, upper


def small_boxes(
    lower: Float32[Array, "n 3"], upper: Float32[Array, "n 3"], eye: Array, limit: float, *, threads: int = 0
) -> UInt8[Array, "n"]:
    """1 where the longest side of a box is less than ``limit`` × its distance from the eye, else 0."""
    small = np.empty(len(lower), np.uint8)
    _core.small_boxes(lower, upper, np.asarray(eye, np.float32), limit, small, threads)
    return small


def depth_flags(
    gaussians: Gaussians, tree: GaussianTree, eye: Array, edges: Array, depths: Array, *, threads: int = 0
) -> UInt8[Array, "n"]:
    """0, 1, 2 where the row is above, at, below the depth of its band: ``depths[b]`` from ``edges[b − 1]`` to ``edges[b]``."""
    flags = np.empty(len(tree), np.uint8)
    squared = np.asarray(edges, np.float32) ** 2
    wanted = np.ascontiguousarray(depths, np.int32)
    _core.depth_flags(gaussians.means, tree.depth, np.asarray(eye, np.float32), squared, wanted, flags, threads)
    return flags


def first_stops(tree: GaussianTree, flags: UInt8[Array, "n"], least: int) -> Int32[Array, "v"]:
    """The first row on each path from a root that is a leaf or has a flag of at least ``least``."""
    rows = np.empty(len(tree), np.int32)
    return rows[: _core.first_stops(flags, tree.subtree_end, least, rows)].copy()
