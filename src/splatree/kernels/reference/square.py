"""The square tile rules of published code: the definition.

3DGS lists a splat in the tiles of a square around its centre, of half side ⌈3 √λ⌉ px, λ the larger eigenvalue of Σ' with a
floor of 0.1 px⁴ under its root (Kerbl 2023, rasterizer). FilterGS shrinks it (2026, §3.3, and its code):

    r = √(2 e λ), e = max(ln(o/τ), 0.01), held within 0.1 · 3 √λ and 3 √λ;  half side max(1, ⌈r + 1⌉)

The paper's r = √(2 σ ln(o/τ)) has this λ, a variance, for σ. The upper bound makes τ = 1/255 change nothing where o > 0.353; the
lower keeps splats with o ≤ τ. Squares ignore where a splat is transparent: they list splats of any opacity.
"""

from typing import NamedTuple

import numpy as np

from splatree.constants import (
    EIGENVALUE_FLOOR_PX4,
    SHRINK_ENERGY_MIN,
    SHRINK_PAD_PX,
    SHRINK_RATIO_MIN,
    SIGMAS,
    TILE_PX,
)
from splatree.scene.view import View
from splatree.shapes import Array

__all__ = ["SquareRule", "half_sides", "rule_of", "tile_range"]


class SquareRule(NamedTuple):
    """How large a square is."""

    threshold: float
    """τ."""
    energy_min: float
    """Floor of ln(o/τ)."""
    ratio_min: float
    """Least share of 3 √λ."""
    pad_px: float
    """Added to the radius, px."""
    eigenvalue_floor_px4: float
    """Under the root of the larger eigenvalue, px⁴."""


def rule_of(view: View) -> SquareRule:
    """The numbers of a square tile rule; `3sigma` is `tau` with nothing that may be shrunk."""
    if view.tile_rule == "3sigma":
        return SquareRule(view.threshold, SHRINK_ENERGY_MIN, 1.0, 0.0, EIGENVALUE_FLOOR_PX4)
    return SquareRule(view.threshold, SHRINK_ENERGY_MIN, SHRINK_RATIO_MIN, SHRINK_PAD_PX, EIGENVALUE_FLOOR_PX4)


def half_sides(xx: Array, xy: Array, yy: Array, opacities: Array, rule: SquareRule) -> Array:
    """Half the side of the square of each splat, px, from its dilated covariance and its opacity."""
    root = np.sqrt(np.maximum(((xx - yy) / 2) ** 2 + xy**2, rule.eigenvalue_floor_px4))
    sigma = np.sqrt((xx + yy) / 2 + root)
    energy = np.maximum(np.log(np.maximum(opacities, 1e-37) / rule.threshold), rule.energy_min)
    radius = np.clip(np.sqrt(2 * energy) * sigma, rule.ratio_min * SIGMAS * sigma, SIGMAS * sigma)
    return np.asarray(np.maximum(np.ceil(radius + rule.pad_px), 1.0))


def tile_range(centres: Array, sides: Array, size_px: int) -> tuple[Array, Array]:
    """First tile and the one after the last, along one axis, that the squares are listed in.

    As Kerbl's code counts them: the centre of the first pixel is 0, and a square ends 15 px before the tile that it ends in.
    """
    num_tiles = -(-size_px // TILE_PX)
    first = np.floor((centres - 0.5 - sides) / TILE_PX)
    end = np.floor((centres - 0.5 + sides + TILE_PX - 1) / TILE_PX)
    return np.clip(first, 0, num_tiles), np.clip(end, 0, num_tiles)
