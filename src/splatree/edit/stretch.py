"""Gaussians under a linear map A that mirrors, stretches or shears space: Σ' = A Σ Aᵀ.

With Σ = (R S)(R S)ᵀ the new half axes are those of the ellipsoid A R S: its singular values are the scales, its left singular
vectors the axes. Nothing is lost of the shape.

A = Q P parts the map into a stretch P and what turns and mirrors, Q (the polar decomposition, so Q is the nearest such map).
Harmonics of each degree are turned and mirrored by the matrix of Q: exactly, if P stretches all axes alike; else colours of
directions in between are not those that a map of directions would give, which harmonics cannot hold. Opacities stay.
"""

from dataclasses import dataclass, replace

import numpy as np

from splatree.kernels.cpu.codec.rotate import rotate_harmonics
from splatree.maths.covariance import axes_from_gaussians
from splatree.maths.harmonics import rotations_of_harmonics
from splatree.maths.rotations import quats_from_matrices
from splatree.scene.gaussians import Gaussians
from splatree.shapes import Array, Float64, check_fields

__all__ = ["Stretch"]


@dataclass(frozen=True, eq=False)
class Stretch:
    """A linear map of space that is no similarity."""

    matrix: Float64[Array, "3 3"]
    """A, which has an inverse."""

    def __post_init__(self) -> None:
        check_fields(self)

    def gaussians(self, g: Gaussians) -> Gaussians:
        """Shapes and harmonics as the map makes them; means stay as they are."""
        u, _, vt = np.linalg.svd(self.matrix)
        matrices = rotations_of_harmonics(u @ vt, g.sh_degree)
        sh = rotate_harmonics(g.sh, matrices) if matrices else g.sh
        axes, scales, _ = np.linalg.svd(self.matrix @ axes_from_gaussians(g.quats, g.log_scales))  # [n 3 3], [n 3]
        axes[np.linalg.det(axes) < 0, :, 0] *= -1  # an axis may point either way
        quats = quats_from_matrices(axes).astype(np.float32)
        return replace(g, quats=quats, log_scales=np.log(scales).astype(np.float32), sh=sh)
