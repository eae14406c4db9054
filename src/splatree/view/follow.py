"""Nodes for a page as they are drawn in a view: merged ones follow the pixel (lod/follow.py), the page draws them as they come.

A page keeps a node until it leaves the cut. Of a node whose pixel has changed much since, shape and opacity are sent again.
"""

import numpy as np

from splatree.scene.view import View
from splatree.shapes import Array, Float32, Float64

__all__ = ["DRIFT", "Depths", "depths_of", "dilations_at"]

DRIFT = 1.15
"""Factor on its dilation in world units² at which a node's shape is sent again: 7 % of its distance."""

Depths = tuple[Float64[Array, "4"], float]
"""The plane (n, d) with the depth n·p + d, and the dilation of a pixel at depth 1, world units²."""


def depths_of(view: View | None) -> Depths | None:
    """How far nodes are from a view, and what a pixel is there; None: nodes do not follow."""
    if view is None or view.mode != "classic":
        return None
    K = view.camera.K
    return np.array(view.camera.camera_from_world[2], np.float64), float(view.dilation_px2 / (K[0, 0] * K[1, 1]))


def dilations_at(means: Float32[Array, "v 3"], limits: Float32[Array, "v"], depths: Depths) -> Float32[Array, "v"]:
    """The dilation at the depth of each node, world units², at most that of its level."""
    plane, unit = depths
    x, y, z = means.T.astype(np.float64)  # no matrix product: its threads would wait for more, and take the processor
    depth = plane[0] * x + plane[1] * y + plane[2] * z + plane[3]
    return np.asarray(np.minimum(unit * depth * depth, limits), np.float32)
