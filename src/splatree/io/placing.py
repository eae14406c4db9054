"""Gaussians put to their place by matrices of a file, in float64, and rounded once, relative to an origin if they lie far off."""

from dataclasses import replace

import numpy as np

from splatree.edit.similarity import Similarity
from splatree.errors import FormatError
from splatree.scene.gaussians import Gaussians
from splatree.scene.origin import NO_ORIGIN, Origin, origin_of
from splatree.shapes import Array, Float64

__all__ = ["Placed", "placed", "settle"]

Placed = tuple[Gaussians, Float64[Array, "n 3"] | None]
"""Gaussians turned and scaled, and their means in float64; None: these are as they stand."""

_ROWS_OF_SAMPLE = 1 << 16


def placed(gaussians: Gaussians, matrix: Float64[Array, "4 4"], where: str, *, origin: Origin = NO_ORIGIN) -> Placed:
    """Turn, scale and move Gaussians, whose means are relative to ``origin``, by a matrix in the axes of our scenes.

    Raises:
        FormatError: it mirrors, shears or stretches.
    """
    linear = matrix[:3, :3]
    scale = float(np.cbrt(np.linalg.det(linear)))
    rotation = linear / scale if scale > 0 else linear
    # Within float32, as which matrices are stored.
    if not (scale > 0 and np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-5)):
        raise FormatError(
            f"{where}: found a node that mirrors, shears or stretches it ({linear.round(6).tolist()}), wanted one "
            "that moves, turns and scales all axes alike"
        )
    if np.array_equal(matrix, np.eye(4)) and origin == NO_ORIGIN:
        return gaussians, None
    means = scale * (gaussians.means.astype(np.float64) + np.asarray(origin)) @ rotation.T + matrix[:3, 3]
    return Similarity(scale, rotation).gaussians(gaussians), means


def settle(parts: list[Placed]) -> tuple[list[Gaussians], Origin]:
    """The parts where they belong, and the origin that their means are relative to."""
    origin = NO_ORIGIN
    if any(means is not None for _, means in parts):
        every = max(1, sum(len(g) for g, _ in parts) // _ROWS_OF_SAMPLE)
        sample = [(g.means.astype(np.float64) if m is None else m)[::every] for g, m in parts]
        origin = origin_of(np.concatenate(sample), np.concatenate([g.log_scales[::every] for g, _ in parts]))
    settled = []
    for g, means in parts:
        if means is not None or origin != NO_ORIGIN:
            world = g.means.astype(np.float64) if means is None else means
            g = replace(g, means=(world - np.asarray(origin)).astype(np.float32))
        settled.append(g)
    return settled, origin
