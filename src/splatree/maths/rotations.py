"""Rotations from quaternions.

A quaternion (w, x, y, z) of any length but zero stands for the rotation of its direction; the matrix takes the Gaussian's
axes to the world.
"""

import numpy as np

from splatree.shapes import Array, Float64

__all__ = ["matrices_from_quats", "matrix_from_angles", "quat_from_matrix"]


def matrix_from_angles(degrees: tuple[float, float, float]) -> Float64[Array, "3 3"]:
    """Turn about the x axis, then about y, then about z, by these angles in degrees: R = R_z R_y R_x."""
    (cx, cy, cz), (sx, sy, sz) = (f(np.radians(np.asarray(degrees, np.float64))) for f in (np.cos, np.sin))
    about_x = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    about_y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    about_z = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
    return np.asarray(about_z @ about_y @ about_x)


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


def quats_from_matrices(rotations: Float64[Array, "n 3 3"]) -> Float64[Array, "n 4"]:
    """Unit quaternions wxyz of exact rotation matrices, by the largest of the four components (Shepperd 1978)."""
    m = np.asarray(rotations, np.float64)
    xx, yy, zz = m[:, 0, 0], m[:, 1, 1], m[:, 2, 2]
    squares = np.stack([1 + xx + yy + zz, 1 + xx - yy - zz, 1 - xx + yy - zz, 1 - xx - yy + zz], axis=1)  # 4 q_i²
    wx, wy, wz = m[:, 2, 1] - m[:, 1, 2], m[:, 0, 2] - m[:, 2, 0], m[:, 1, 0] - m[:, 0, 1]  # 4 q_0 q_i
    xy, xz, yz = m[:, 1, 0] + m[:, 0, 1], m[:, 0, 2] + m[:, 2, 0], m[:, 2, 1] + m[:, 1, 2]
    w, x, y, z = squares.T
    products = np.stack([w, wx, wy, wz, wx, x, xy, xz, wy, xy, y, yz, wz, xz, yz, z], axis=1).reshape(-1, 4, 4)
    rows = np.take_along_axis(products, squares.argmax(axis=1)[:, None, None], axis=1)[:, 0]
    return np.asarray(rows / np.linalg.norm(rows, axis=1, keepdims=True))


def quat_from_matrix(rotation: Array) -> Float64[Array, "4"]:
    """The unit quaternion wxyz, w ≥ 0, of a rotation matrix; of one that is slightly off, the nearest (Bar-Itzhack 2000).

    It maximises a quadratic form in (w, x, y, z): the eigenvector of the largest eigenvalue, defined for every angle.
    """
    m = np.asarray(rotation, np.float64)
    form = np.zeros((4, 4))
    form[0, 0] = np.trace(m)
    form[0, 1:] = form[1:, 0] = m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]
    form[1:, 1:] = m + m.T - np.trace(m) * np.eye(3)
    q = np.linalg.eigh(form)[1][:, -1]
    return np.asarray(q if q[0] >= 0 else -q)
