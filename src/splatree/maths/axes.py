"""Mirrored coordinate axes: which signs of a Gaussian change when some axes of the world point the other way.

Formats name the directions of x, y, z by a letter each: left or right, up or down, front or back. Training output has RDF
(COLMAP), SPZ prescribes RUB, glTF LUF. Between two such frames a point is mirrored by signs s = (±1, ±1, ±1), so with S = diag(s)

- a mean m becomes S m;
- a covariance Σ = R D² Rᵀ becomes S Σ S = (S R S) D² (S R S)ᵀ, as S commutes with the diagonal D: the scales stay, and the axis v
  of the rotation, a pseudovector, becomes det(S) S v;
- a harmonic is even or odd along each axis, Y_k(S d) = σ_k Y_k(d), so that its coefficient is multiplied by σ_k.

All are changes of signs, which rounding never touches.
"""

from typing import Final, Literal, get_args

import numpy as np

from splatree.maths.harmonics import basis_from_directions
from splatree.shapes import Array, Float32

__all__ = ["AXES", "AxesName", "harmonic_signs", "quat_signs", "signs_between"]

AxesName = Literal["LDB", "RDB", "LUB", "RUB", "LDF", "RDF", "LUF", "RUF"]
"""Frames whose x is sideways, y vertical and z depth."""

AXES: Final[tuple[str, ...]] = get_args(AxesName)
"""All frames; each bit of the index is one axis."""


def signs_between(source: str, target: str) -> Float32[Array, "3"]:
    """Signs that take the coordinates of a point from one of `AXES` to another."""
    return np.array([1 if a == b else -1 for a, b in zip(source, target, strict=True)], np.float32)


def quat_signs(signs: Array) -> Float32[Array, "4"]:
    """Signs of a quaternion wxyz under the mirror ``signs``."""
    return np.array([1, *(np.prod(signs) * signs)], np.float32)


def harmonic_signs(signs: Array, degree: int) -> Float32[Array, "k"]:
    """Signs of the harmonics, DC first, under the mirror ``signs``."""
    direction = np.array([0.36, 0.48, 0.8])  # where no harmonic up to degree 3 vanishes
    product = basis_from_directions(direction * signs, degree) * basis_from_directions(direction, degree)
    return np.asarray(np.sign(product), np.float32)
