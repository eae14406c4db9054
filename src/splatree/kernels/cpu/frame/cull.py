"""Which spheres or boxes can be seen: glue over cull.cpp; kernels/reference/cull.py is the definition."""

import numpy as np

from splatree.kernels.cpu import _core
from splatree.scene.clusters import Sides
from splatree.shapes import Array, Bool, Float32

__all__ = ["cull", "cull_boxes"]


def cull(
    centers: Float32[Array, "c 3"],
    radii: Float32[Array, "c"],
    near_radii: Float32[Array, "c"],
    sides: Sides,
    *,
    threads: int = 0,
) -> Bool[Array, "c"]:
    """Whether each sphere is on none of the outer sides; the near side, the last, takes ``near_radii``."""
    kept = np.empty(len(centers), bool)
    _core.cull_spheres(centers, radii, near_radii, sides, kept, threads)
    return kept


def cull_boxes(
    low: Float32[Array, "c 3"], high: Float32[Array, "c 3"], sides: Sides, *, threads: int = 0
) -> Bool[Array, "c"]:
    """Whether each box is on none of the outer sides."""
    assert sides.box_reaches is not None
    kept = np.empty(len(low), bool)
    _core.cull_boxes(low, high, sides, kept, threads)
    return kept
