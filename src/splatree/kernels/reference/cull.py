"""Which spheres or boxes can be seen, by definition (scene/clusters.py: `Sides`)."""

import numpy as np

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
    x = centers.astype(np.float64)
    beyond = x @ sides.planes[:, :3].T + sides.planes[:, 3]  # [c 5]
    used = np.column_stack([radii] * 4 + [near_radii]).astype(np.float64)
    used = sides.scale * used + sides.slack * np.abs(x - sides.eye).sum(axis=1)[:, None] + sides.margin
    kept = ~(beyond > sides.reaches * used).any(axis=1)
    if sides.guard:
        kept |= np.abs(beyond[:, 4]) <= radii
    return np.asarray(kept)


def cull_boxes(
    low: Float32[Array, "c 3"], high: Float32[Array, "c 3"], sides: Sides, *, threads: int = 0
) -> Bool[Array, "c"]:
    """Whether each box is on none of the outer sides."""
    assert sides.box_reaches is not None
    with np.errstate(invalid="ignore"):  # an infinite box has no centre, and is kept
        center = (low.astype(np.float64) + high) / 2
        half = (high.astype(np.float64) - low) / 2
        beyond = center @ sides.planes[:, :3].T + sides.planes[:, 3]  # [c 5]
        added = sides.slack * np.abs(center - sides.eye).sum(axis=1)[:, None] + sides.margin
        return np.asarray(~(beyond > half @ sides.box_reaches.T + sides.reaches * added).any(axis=1))
