"""Gaussians under a linear map A that mirrors, stretches or shears space: Σ' = A Σ Aᵀ.

With Σ = (R S)(R S)ᵀ the new half axes are those of the ellipsoid A R S: its singular values are the scales, its left singular
vectors the axes. Nothing is lost of the shape.

A = Q P parts the map into a stretch P and what turns and mirrors, Q (the polar decomposition, so Q is the nearest such map).
Harmonics of degree l are turned by the Wigner matrix of Q, and change signs where it mirrors: exactly, if P stretches all axes
alike; else colours of directions in between are not those that a map of directions would give, which harmonics cannot hold.
Opacities stay.
"""

from dataclasses import dataclass, replace

import numpy as np

from splatree.edit.similarity import Similarity
from splatree.maths.axes import harmonic_signs
from splatree.maths.covariance import axes_from_gaussians
from splatree.maths.rotations import quats_from_matrices
from splatree.scene.gaussians import Gaussians
from splatree.shapes import Array, Float64, check_fields

__all__ = ["Stretch"]

_MIRROR = np.array([-1.0, 1.0, 1.0])
"""A mirror of x: any map that mirrors is this one, and then one that does not."""


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
        turn, signs = u @ vt, np.ones(3)
        if np.linalg.det(turn) < 0:
            turn, signs = turn * _MIRROR, _MIRROR
        # Similarity turns quaternions, too; those of the shapes replace them.
        turned = Similarity(rotation=turn).gaussians(
            replace(g, sh=g.sh * harmonic_signs(signs, g.sh_degree)[:, None]), g.means
        )
        axes, scales, _ = np.linalg.svd(self.matrix @ axes_from_gaussians(g.quats, g.log_scales))  # [n 3 3], [n 3]
        axes[np.linalg.det(axes) < 0, :, 0] *= -1  # an axis may point either way
        quats = quats_from_matrices(axes).astype(np.float32)
        return replace(turned, quats=quats, log_scales=np.log(scales).astype(np.float32))
