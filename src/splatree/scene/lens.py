"""Lenses that bend straight lines: where a lens shows a direction, and which direction a lens shows at a place.

A direction is given by its slopes (u, v) = (x / z, y / z), with r their length and θ = arctan r its angle from the axis; a place
in the picture by its distance from the principal point in focal lengths. A pinhole shows (u, v) at (u, v). A lens shows it at

    d = f b + (2 p1 bx by + p2 (b² + 2 bx²) + s1 b²,   2 p2 bx by + p1 (b² + 2 by²) + s2 b²)

    b = (u, v)            brown     f = (1 + k1 b² + k2 b⁴ + …) / (1 + q1 b² + q2 b⁴ + …)
    b = (u, v) θ / r      fisheye   f likewise
    b = (u, v)            fov       f = arctan(2 b tan(ω / 2)) / (b ω),   ω = k1

These are the models of OpenCV and COLMAP (colmap.github.io/cameras.html) in one form. The inverse is found by a table of the
radius, exact to 1e-9, and by fixed-point steps for the terms p and s, which are small in any real lens.
"""

import math
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from splatree.errors import InputError
from splatree.shapes import Array, Float64

__all__ = ["ANGLE_MAX", "Lens", "LensModel"]

LensModel = Literal["brown", "fisheye", "fov"]
"""How a lens bends: as OpenCV's pinhole with distortion, as OpenCV's fisheye, or by one angle (Devernay 2001)."""

ANGLE_MAX = math.radians(75)
"""Directions further than this from the axis are not shown by a flat picture: at 75° it is stretched fifteen times."""

_TABLE = 1 << 16
_STEPS = 30
_PRECISION = 1e-6
"""Largest error of an inverse in focal lengths: a thousandth of a pixel at 1,000 px."""


@dataclass(frozen=True)
class Lens:
    """How a camera bends directions before they meet its picture; hashable, equal for equal coefficients."""

    model: LensModel
    """Formula of the radius."""
    radial: tuple[float, ...] = ()
    """k1, k2, …: coefficients of b², b⁴, …; of `fov` the angle ω alone, radians."""
    divisor: tuple[float, ...] = ()
    """q1, q2, …: the same below the line (k4, k5, k6 of OpenCV)."""
    tangential: tuple[float, float] = (0.0, 0.0)
    """p1, p2: a sensor that is not square to the axis."""
    prism: tuple[float, float] = (0.0, 0.0)
    """s1, s2: a thin prism."""

    def __post_init__(self) -> None:
        if self.model not in get_args(LensModel):
            raise InputError(f"Lens.model: found {self.model!r}, wanted one of {', '.join(get_args(LensModel))}")
        if not all(map(math.isfinite, (*self.radial, *self.divisor, *self.tangential, *self.prism))):
            raise InputError(f"Lens: found NaN or infinity among {self}, wanted finite coefficients")

    @property
    def is_straight(self) -> bool:
        """Whether it bends nothing: then the camera is a pinhole."""
        bends = any((*self.radial, *self.divisor, *self.tangential, *self.prism))
        return self.model != "fisheye" and not bends

    def bent(self, slopes: Float64[Array, "… 2"]) -> Float64[Array, "… 2"]:
        """Where directions are shown, in focal lengths from the principal point."""
        base = slopes
        if self.model == "fisheye":
            r = np.linalg.norm(slopes, axis=-1, keepdims=True)
            base = slopes * _ratio(np.arctan(r), r)
        return np.asarray(base * self._factor(np.linalg.norm(base, axis=-1, keepdims=True)) + self._oblique(base))

    def straight(self, shown: Float64[Array, "… 2"]) -> Float64[Array, "… 2"]:
        """The slopes of the directions that are shown at places; NaN where none within `ANGLE_MAX` of the axis is."""
        limit = ANGLE_MAX if self.model == "fisheye" else math.tan(ANGLE_MAX)
        b = np.linspace(0, limit, _TABLE)
        d = b * self._factor(b)
        turn = np.flatnonzero(np.diff(d) <= 0)  # beyond it the lens folds back
        end = int(turn[0]) + 1 if len(turn) else _TABLE

        def base_of(radial: Array) -> Array:
            length = np.linalg.norm(radial, axis=-1, keepdims=True)
            return np.asarray(radial * _ratio(np.interp(length, d[:end], b[:end], right=np.nan), length))

        base = base_of(shown)
        if any((*self.tangential, *self.prism)):
            for _ in range(_STEPS):
                before, base = base, base_of(shown - self._oblique(base))
                if not np.nanmax(np.abs(base - before), initial=0.0) > _PRECISION / 100:
                    break
        r = np.linalg.norm(base, axis=-1, keepdims=True)
        slopes = base * _ratio(np.tan(r), r) if self.model == "fisheye" else base
        missed = ~(np.abs(self.bent(slopes) - shown).max(axis=-1) <= _PRECISION)
        return np.asarray(np.where(missed[..., None], np.nan, slopes))

    def _factor(self, b: Array) -> Array:
        """f at the radius b."""
        if self.model == "fov":
            omega = self.radial[0] if self.radial else 0.0
            if abs(omega) < 1e-6:
                return np.ones_like(b)
            wide = 2 * math.tan(omega / 2)
            return np.asarray(_ratio(np.arctan(wide * b), b, at_zero=wide) / omega)
        above, below = (np.polynomial.Polynomial((1.0, *k))(b * b) for k in (self.radial, self.divisor))
        return np.asarray(above / below)

    def _oblique(self, base: Array) -> Array:
        """The terms that depend on the direction around the axis."""
        (p1, p2), (s1, s2) = self.tangential, self.prism
        if not any((p1, p2, s1, s2)):
            return np.zeros_like(base)
        x, y = base[..., 0], base[..., 1]
        square = x * x + y * y
        across = 2 * p1 * x * y + p2 * (square + 2 * x * x) + s1 * square
        down = 2 * p2 * x * y + p1 * (square + 2 * y * y) + s2 * square
        return np.stack([across, down], axis=-1)


def _ratio(above: Array, below: Array, *, at_zero: float = 1.0) -> Array:
    """``above / below``, and its limit where both vanish."""
    small = np.abs(below) < 1e-12
    return np.asarray(np.where(small, at_zero, above / np.where(small, 1, below)))
