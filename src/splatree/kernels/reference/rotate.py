"""Harmonics of a turned scene."""

from collections.abc import Sequence

import numpy as np

from splatree.shapes import Array, Float64

__all__ = ["rotate_harmonics"]


def rotate_harmonics(sh: Array, matrices: Sequence[Array]) -> Float64[Array, "n k 3"]:
    """Each degree's coefficients times its matrix of ``matrices`` (degree 1 first); the DC as it is."""
    blocks = [np.ones((1, 1)), *matrices]
    starts = [degree * degree for degree in range(len(blocks) + 1)]
    parts = [
        np.einsum("kj,njc->nkc", block, np.asarray(sh, np.float64)[:, begin:end])
        for block, begin, end in zip(blocks, starts, starts[1:], strict=False)
    ]
    return np.concatenate(parts, axis=1)
