"""Boxes along the axes around Gaussians."""

import math
from collections.abc import Callable, Sequence

import numpy as np

from splatree.maths.covariance import axes_from_gaussians
from splatree.scene.gaussians import Gaussians
from splatree.shapes import Array, Float64

__all__ = ["box_around", "outward"]

_DIGITS = 7


def box_around(gaussians: Gaussians, starts: Array, *, sigmas: float) -> Float64[Array, "g 2 3"]:
    """Lower and upper corner of the box around the ellipsoids of ``sigmas`` standard deviations of each run of rows.

    A run begins at each of ``starts``, which ascend from 0. An ellipsoid reaches √Σᵢᵢ along axis i.
    """
    axes = axes_from_gaussians(gaussians.quats, gaussians.log_scales)
    reach = sigmas * np.sqrt(np.einsum("nij,nij->ni", axes, axes))
    low = np.minimum.reduceat(gaussians.means - reach, starts, axis=0)
    high = np.maximum.reduceat(gaussians.means + reach, starts, axis=0)
    return np.stack([low, high], axis=1)


def outward(low: Sequence[float] | Array, high: Sequence[float] | Array) -> tuple[list[float], list[float]]:
    """The corners of a box with seven digits, rounded so that the box holds what it held."""
    return [_rounded(float(v), math.floor) for v in low], [_rounded(float(v), math.ceil) for v in high]


def _rounded(value: float, towards: Callable[[float], int]) -> float:
    if value == 0:
        return 0.0
    step = 10.0 ** (math.floor(math.log10(abs(value))) + 1 - _DIGITS)
    return float(f"{towards(value / step) * step:.{_DIGITS}g}")
