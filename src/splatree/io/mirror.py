"""Gaussians in mirrored axes, in place: what readers of formats with axes of their own end with (`splatree.maths.axes`)."""

import numpy as np

from splatree.maths.axes import harmonic_signs, quat_signs
from splatree.scene.gaussians import Gaussians
from splatree.shapes import Array, Float32

__all__ = ["mirror"]


@np.errstate(invalid="ignore")  # a signalling NaN from a file is left to the check of values
def mirror(gaussians: Gaussians, signs: Float32[Array, "3"]) -> None:
    """Change the signs of the columns of ``gaussians`` as the mirror ``signs`` of the axes asks."""
    if (signs == 1).all():
        return
    for column, factors in (
        (gaussians.means, signs),
        (gaussians.quats, quat_signs(signs)),
        (gaussians.sh, harmonic_signs(signs, gaussians.sh_degree)[:, None]),
    ):
        column *= factors
