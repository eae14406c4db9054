"""Which spheres can be seen, by definition (scene/clusters.py: `Sides`)."""

import numpy as np

from splatree.scene.clusters import Sides
from splatree.shapes import Array, Bool, Float32

__all__ = ["cull"]


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
