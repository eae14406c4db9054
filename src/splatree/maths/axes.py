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

__all__ = ["AXES", "AxesName", "harmonic_signs", "quat_signs", "signs_between", "y_of_a_thing"]

AxesName = Literal["LDB", "RDB", "LUB", "RUB", "LDF", "RDF", "LUF", "RUF"]
"""Frames whose x is sideways, y vertical and z depth."""

AXES: Final[tuple[str, ...]] = get_args(AxesName)
"""All frames; each bit of the index is one axis."""

_FEW = 0.002
"""Share of the rows that may lie anywhere: a few floaters under the feet of a thing do not hide that it stands on 0."""

_AT_ZERO = 0.02
"""Distance of its feet from 0, as a share of the height."""

_OVER_ZERO = 0.1
"""Distance of its middle from the vertical through 0, as a share of the width."""

_SLAB = 0.2
"""Height as a share of the width: below it, it may be a cell of a city that was cut at 0."""


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


def y_of_a_thing(means: Array) -> int:
    """1 if the scene is a thing that stands on y = 0 over the origin with y up, −1 if with y down, 0 if it is none.

    Modelled and cleaned things stand so. Captures as they were trained have 0 amid the cameras; cells of a large scene may be cut
    at 0, but are flat or lie aside.
    """
    if len(means) == 0:
        return 0
    (x0, low, z0), (x, _, z), (x1, high, z1) = np.quantile(means, (_FEW, 0.5, 1 - _FEW), axis=0).tolist()
    height, width = high - low, max(x1 - x0, z1 - z0)
    if max(abs(x), abs(z)) > _OVER_ZERO * width or height < _SLAB * width:
        return 0
    return int(abs(low) < _AT_ZERO * height) - int(abs(high) < _AT_ZERO * height)
