"""Covariances of Gaussians.

Kerbl 2023, Eq. 6: Σ = R S Sᵀ Rᵀ with the rotation R and the diagonal S of standard deviations. The columns of R S are the
half axes of the 1σ ellipsoid; work on these factors where differences of large numbers would cancel in Σ.
"""

import numpy as np

from splatree.maths.rotations import matrices_from_quats
from splatree.shapes import Array, Float64

__all__ = ["axes_from_gaussians", "covariances_from_gaussians"]


def axes_from_gaussians(quats: Array, log_scales: Array) -> Float64[Array, "n 3 3"]:
    """R S: column j is the half axis j of the 1σ ellipsoid, world units."""
    scales = np.exp(np.asarray(log_scales, np.float64))
    return np.asarray(matrices_from_quats(quats) * scales[..., None, :])


def covariances_from_gaussians(quats: Array, log_scales: Array) -> Float64[Array, "n 3 3"]:
    """Σ = R S Sᵀ Rᵀ, world units²."""
    axes = axes_from_gaussians(quats, log_scales)
    return np.asarray(axes @ np.swapaxes(axes, -1, -2))
