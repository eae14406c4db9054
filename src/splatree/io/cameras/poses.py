"""Rotations of poses as files give them: to few digits, or scaled with the world that they are in.

A matrix s R with one scale s in all directions shows what R shows, because pixels are ratios of coordinates of the camera. Digits
that are left out make it a little more than a rotation; the nearest one is U Vᵀ of its singular value decomposition U D Vᵀ.
"""

import numpy as np

from splatree.errors import FormatError
from splatree.scene.cameras import ROTATION_TOLERANCE
from splatree.shapes import Array, Float64

__all__ = ["Rotations"]

_OFF_MAX = 0.05
"""How far the scales of a matrix may be apart, as a share: matrices of two digits are off by up to 0.02."""


class Rotations:
    """Takes rotations of one file, and counts those that it had to mend."""

    def __init__(self) -> None:
        self._num_scaled, self._num_rounded, self._most = 0, 0, 0.0

    def of(self, matrix: Float64[Array, "3 3"], where: str) -> Float64[Array, "3 3"]:
        """The rotation of a matrix: itself, or if it is none, the nearest.

        Raises:
            FormatError: it mirrors, or stretches by more than digits that are left out.
        """
        square = matrix @ matrix.T
        if np.allclose(square, np.eye(3), atol=ROTATION_TOLERANCE) and np.linalg.det(matrix) > 0:
            return matrix
        if not np.isfinite(square).all() or not matrix.any():
            raise FormatError(f"{where}: found the matrix {matrix.tolist()}, wanted a rotation")
        u, sizes, vt = np.linalg.svd(matrix)
        rotation, scale = u @ vt, float(sizes.mean())
        off = float(np.ptp(sizes)) / scale
        if np.linalg.det(rotation) < 0 or off > _OFF_MAX:
            what = "mirrors" if np.linalg.det(rotation) < 0 else "stretches or shears"
            raise FormatError(
                f"{where}: its rotation is not orthonormal with determinant +1, up to one scale: the matrix "
                f"{matrix.round(6).tolist()} {what}"
            )
        self._num_scaled += abs(scale - 1) > max(off, ROTATION_TOLERANCE)  # more than what rounding explains
        self._num_rounded += off > ROTATION_TOLERANCE
        self._most = max(self._most, off)
        return np.asarray(rotation)

    @property
    def notes(self) -> tuple[str, ...]:
        """What was mended, a sentence each."""
        notes = []
        if self._num_scaled:
            notes.append(f"the matrices of {_cameras(self._num_scaled)} are scaled: their rotations are taken")
        if self._num_rounded:
            notes.append(
                f"the matrices of {_cameras(self._num_rounded)} are no exact rotations (off by up to {100 * self._most:.2g} %): "
                "the nearest ones are taken"
            )
        return tuple(notes)


def _cameras(number: int) -> str:
    return f"{number} camera{'s' * (number != 1)}"
