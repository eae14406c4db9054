"""Rotations from quaternions.

A quaternion (w, x, y, z) of any length but zero stands for the rotation of its direction; the matrix takes the Gaussian's
axes to the world.
"""

import numpy as np

from splatree.shapes import Array, Float64

__all__ = ["matrices_from_quats"]


def matrices_from_quats(quats: Array) -> Float64[Array, "n 3 3"]:
    """Rotation matrices of quaternions wxyz, which need not be of unit length.

    A zero quaternion gives the identity, as if it were (1, 0, 0, 0).
    """
    q = np.asarray(quats, np.float64)
    squared = np.sum(q * q, axis=-1)
    # R = I + s (…) with s = 2 / |q|²: no square root, exact for any length.
    s = np.divide(2.0, squared, out=np.zeros_like(squared), where=squared > 0)
    w, x, y, z = (q[..., i] for i in range(4))
    rows = [
        [1 - s * (y * y + z * z), s * (x * y - w * z), s * (x * z + w * y)],
        [s * (x * y + w * z), 1 - s * (x * x + z * z), s * (y * z - w * x)],
        [s * (x * z - w * y), s * (y * z + w * x), 1 - s * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
