"""Coordinates far from zero: where the zero of a scene lies, so that float32 keeps what the file says.

Float32 has 24 bits: at a northing of 4,500,000 m neighbouring numbers are half a metre apart. A reader that finds coordinates
with more digits takes an origin off them, in float64, before they are rounded: `Source.origin`, world units, to be added to the
means. It is taken axis by axis, and only where steps would be coarse beside the Gaussians.
"""

import math

import numpy as np

from splatree.shapes import Array, Float32, Float64

__all__ = ["NO_ORIGIN", "STEPS_PER_SIGMA", "Origin", "coarsest_step", "origin_of", "settled"]

Origin = tuple[float, float, float]
"""x, y, z of the zero of a scene in the world, world units."""

NO_ORIGIN: Origin = (0.0, 0.0, 0.0)

STEPS_PER_SIGMA = 32
"""Steps of a coordinate within a standard deviation of the median Gaussian: with fewer, moves of its centre can be seen."""

_FAR = 2.0**17
"""A scene without an origin that is moved further than this gets one: steps there are 1/64."""

_NEAR = 2.0**-10
"""An origin that is left after a move is added to the means where it is so much smaller than before: float32 gains ten bits."""


def origin_of(points: Float64[Array, "s 3"], log_scales: Float32[Array, "s 3"]) -> Origin:
    """The origin to take off points before they are rounded to float32, from a sample of a scene's rows; zeros if none needed."""
    known = np.isfinite(points).all(axis=1) & np.isfinite(log_scales).all(axis=1)
    if not known.any():
        return NO_ORIGIN
    points, sigma = points[known], math.exp(min(float(np.median(log_scales[known])), 80.0))
    origin = []
    for axis in range(3):
        centre = float(np.median(points[:, axis]))
        low, high = np.quantile(points[:, axis], (0.05, 0.95))
        if not 0 < abs(centre) < 1e30 or coarsest_step(centre) * STEPS_PER_SIGMA <= sigma:
            origin.append(0.0)
            continue
        unit = 10.0 ** math.ceil(math.log10(max(float(high - low), 1e-4 * abs(centre))))
        rounded = round(centre / unit) * unit
        # A scene as wide as it is far gains nothing by it.
        origin.append(rounded if coarsest_step(centre - rounded) <= coarsest_step(centre) / 8 else 0.0)
    return origin[0], origin[1], origin[2]


def coarsest_step(coordinate: float) -> float:
    """The distance of float32 numbers next to a coordinate."""
    return float(np.spacing(np.float32(abs(coordinate))))


def settled(target: Float64[Array, "3"], before: Origin) -> tuple[Origin, Float64[Array, "3"]]:
    """An origin after a move, and what is to be added to the means in its place on the axes where it has become small."""
    largest = max(map(abs, before))
    far = np.abs(target) > (_NEAR * largest if largest else _FAR)
    origin = np.where(far, target, 0.0)
    return (float(origin[0]), float(origin[1]), float(origin[2])), np.asarray(np.where(far, 0.0, target))
