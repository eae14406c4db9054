"""Boxes along the axes around Gaussians."""

import math
from collections.abc import Callable, Sequence

import numpy as np

from splatree.maths.covariance import axes_from_gaussians
from splatree.scene.gaussians import Gaussians
from splatree.shapes import Array, Float64

__all__ = ["around_usual", "box_around", "outward"]

_DIGITS = 7

_AROUND = 0.5
"""How far boxes that viewers choose by reach beyond their Gaussians, in half sides of a usual box. At 0 near views lose up to
0.8 dB on the mean of a scene; at 1 and at 0.75 single ones lose 0.9 and 1.4 dB, because the nearest chunks take the budget."""


def box_around(gaussians: Gaussians, starts: Array, *, sigmas: float) -> Float64[Array, "g 2 3"]:
    """Lower and upper corner of the box around the ellipsoids of ``sigmas`` standard deviations of each run of rows.

    A run begins at each of ``starts``, which ascend from 0. An ellipsoid reaches √Σᵢᵢ along axis i.
    """
    axes = axes_from_gaussians(gaussians.quats, gaussians.log_scales)
    reach = sigmas * np.sqrt(np.einsum("nij,nij->ni", axes, axes))
    low = np.minimum.reduceat(gaussians.means - reach, starts, axis=0)
    high = np.maximum.reduceat(gaussians.means + reach, starts, axis=0)
    return np.stack([low, high], axis=1)


def around_usual(boxes: Float64[Array, "c 2 3"]) -> Float64[Array, "c 2 3"]:
    """The boxes, all larger to each side by half of the median half side.

    A viewer's bands of distance triple, but the nodes of a level are about twice as large as those of the level before. So a
    viewer would spend too much of its budget far away. All distances become shorter by the same length: near ones by a larger
    share, so bands are narrower near the eye, and nodes grow more nearly as their distance does. Far views change little.
    """
    margin = _AROUND * float(np.median(boxes[:, 1] - boxes[:, 0])) / 2
    return np.stack([boxes[:, 0] - margin, boxes[:, 1] + margin], axis=1)


def outward(low: Sequence[float] | Array, high: Sequence[float] | Array) -> tuple[list[float], list[float]]:
    """The corners of a box with seven digits, rounded so that the box holds what it held."""
    return [_rounded(float(v), math.floor) for v in low], [_rounded(float(v), math.ceil) for v in high]


def _rounded(value: float, towards: Callable[[float], int]) -> float:
    if value == 0:
        return 0.0
    step = 10.0 ** (math.floor(math.log10(abs(value))) + 1 - _DIGITS)
    return float(f"{towards(value / step) * step:.{_DIGITS}g}")
