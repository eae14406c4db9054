"""Real spherical harmonics up to degree 3, with the order and the signs of Kerbl 2023.

The colour seen along direction d is c(d) = Σ_k Y_k(d) sh_k, plus ½, clipped below at 0.
"""

import numpy as np

from splatree.constants import SH_C0, SH_C1, SH_C2, SH_C3
from splatree.shapes import Array, Float64

__all__ = ["basis_from_directions", "basis_gradients", "colors_from_harmonics", "rotations_of_harmonics"]


def basis_from_directions(directions: Array, degree: int) -> Float64[Array, "n k"]:
    """Y_k of unit directions, k = (degree + 1)² of them."""
    d = np.asarray(directions, np.float64)
    x, y, z = d[..., 0], d[..., 1], d[..., 2]
    xx, yy, zz = x * x, y * y, z * z
    columns = [np.full_like(x, SH_C0)]
    if degree >= 1:
        columns += [-SH_C1 * y, SH_C1 * z, -SH_C1 * x]
    if degree >= 2:
        quadratic = (x * y, y * z, 2 * zz - xx - yy, x * z, xx - yy)
        columns += [c * p for c, p in zip(SH_C2, quadratic, strict=True)]
    if degree >= 3:
        cubic = (
            y * (3 * xx - yy),
            x * y * z,
            y * (4 * zz - xx - yy),
            z * (2 * zz - 3 * xx - 3 * yy),
            x * (4 * zz - xx - yy),
            z * (xx - yy),
            x * (xx - 3 * yy),
        )
        columns += [c * p for c, p in zip(SH_C3, cubic, strict=True)]
    return np.stack(columns, axis=-1)


def basis_gradients(directions: Array, degree: int) -> Float64[Array, "n k 3"]:
    """Derivatives of the polynomials Y_k by x, y and z, as if these were free; their part across the direction is what counts."""
    x, y, z = (np.asarray(directions, np.float64)[..., i] for i in range(3))
    xx, yy, zz, o, one = x * x, y * y, z * z, np.zeros_like(x), np.ones_like(x)
    rows = [(o, o, o)]
    if degree >= 1:
        rows += [(o, -SH_C1 * one, o), (o, o, SH_C1 * one), (-SH_C1 * one, o, o)]
    if degree >= 2:
        quadratic = ((y, x, o), (o, z, y), (-2 * x, -2 * y, 4 * z), (z, o, x), (2 * x, -2 * y, o))
        rows += [(c * a, c * b, c * d) for c, (a, b, d) in zip(SH_C2, quadratic, strict=True)]
    if degree >= 3:
        cubic = (
            (6 * x * y, 3 * xx - 3 * yy, o),
            (y * z, x * z, x * y),
            (-2 * x * y, 4 * zz - xx - 3 * yy, 8 * y * z),
            (-6 * x * z, -6 * y * z, 6 * zz - 3 * xx - 3 * yy),
            (4 * zz - 3 * xx - yy, -2 * x * y, 8 * x * z),
            (2 * x * z, -2 * y * z, xx - yy),
            (3 * xx - 3 * yy, -6 * x * y, o),
        )
        rows += [(c * a, c * b, c * d) for c, (a, b, d) in zip(SH_C3, cubic, strict=True)]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def colors_from_harmonics(sh: Array, directions: Array, degree: int) -> Float64[Array, "n 3"]:
    """Colours seen along unit directions from the eye to each Gaussian, up to ``degree``."""
    basis = basis_from_directions(directions, degree)
    sums = np.einsum("nk,nkc->nc", basis, np.asarray(sh, np.float64)[:, : basis.shape[-1]])
    return np.asarray(np.maximum(sums + 0.5, 0.0))


def rotations_of_harmonics(R: Float64[Array, "3 3"], degree: int) -> list[Float64[Array, "m m"]]:
    """For each degree 1 … ``degree`` the matrix D that turns its 2l + 1 coefficients with the scene (Wigner); R may mirror, too.

    The turned scene shows in direction d what the scene showed in Rᵀd: Y(d)ᵀ D sh = Y(Rᵀd)ᵀ sh for all d. A degree is closed
    under rotations and mirrors, so the equations of a few directions determine D exactly, up to rounding.
    """
    # Directions spread evenly (Fibonacci's spiral): the equations are as well conditioned as the functions are orthogonal.
    i = np.arange(32)
    z, angle = (2 * i + 1) / 32 - 1, i * np.pi * (3 - np.sqrt(5))
    directions = np.stack([np.sqrt(1 - z * z) * np.cos(angle), np.sqrt(1 - z * z) * np.sin(angle), z], axis=1)
    at, turned = (basis_from_directions(d, degree) for d in (directions, directions @ R))  # rows of d R are Rᵀd
    blocks = [slice(band**2, (band + 1) ** 2) for band in range(1, degree + 1)]
    return [np.linalg.lstsq(at[:, block], turned[:, block], rcond=None)[0] for block in blocks]
