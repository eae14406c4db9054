"""Harmonics of a turned scene, on the processor; the same bits on every one."""

from collections.abc import Sequence

import numpy as np

from splatree.kernels.cpu import _core
from splatree.shapes import Array, Float32

__all__ = ["rotate_harmonics"]


def rotate_harmonics(
    sh: Float32[Array, "n k 3"], matrices: Sequence[Array], *, threads: int = 0
) -> Float32[Array, "n k 3"]:
    """Each degree's coefficients times its matrix of ``matrices`` (degree 1 first); the DC as it is."""
    flat = np.concatenate([np.zeros(0), *(m.reshape(-1) for m in matrices)]).astype(np.float32)
    out = np.empty_like(sh)
    _core.rotate_harmonics(sh, flat, out, threads)
    return out
