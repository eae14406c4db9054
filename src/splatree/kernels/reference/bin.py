"""List the splats of each tile: the definition.

A splat belongs to a tile of 16 × 16 px iff its ellipse |L d| ≤ k, k = √(2 ln(o/τ)), reaches into the rectangle of the tile's
pixel centres. The smallest |L d| over a rectangle is 0 if the centre lies inside; else it is on the border, where |L d|² is a
parabola along each side. Nothing is lost: a pair left out has opacity below τ at every pixel of the tile. The tile rules
`tau` and `3sigma` list a square instead (square.py).

By the tile rule `balanced` a splat ends at τ (0.3 px² / √det Σ')^0.4 instead, but at 1/255 at least. The error of a lost tile
grows with the size of the splat; the cost of a pair does not.

With `taper` a splat gets a floor: its largest opacity in a tile of the picture that it is not listed in, held within 1/255
and the opacity at which it ends. A splat that is listed in all its tiles down to 1/255 has the floor 1/255: it is drawn as it is.
"""

import numpy as np

from splatree.constants import ALPHA_THRESHOLD, SHRINK_AREA_PX2, TILE_PX
from splatree.kernels.reference.square import half_sides, rule_of, tile_range
from splatree.scene.cameras import Camera
from splatree.scene.frame import Splats, TileBins, tiles_of
from splatree.scene.view import View
from splatree.shapes import Array

__all__ = ["bin", "smallest_distances"]


def bin(splats: Splats, view: View, *, threads: int = 0) -> TileBins:
    """Pairs of splat and tile, tile by tile and nearest first; ``threads`` is not used."""
    num_x, num_y = tiles_of(view.camera)
    thresholds = _thresholds(splats, view)
    k_squared = 2 * np.log(np.maximum(splats.opacities.astype(np.float64), 1e-37) / thresholds)
    if not view.is_square:
        distances = smallest_distances(splats, view.camera)  # [v t]
        touches = distances**2 <= k_squared[:, None]
    else:
        touches = _squares_touch(splats, view)
    lists = [splats.order[touches[splats.order, t]] for t in range(num_x * num_y)]
    tile_start = np.concatenate([[0], np.cumsum([len(tile) for tile in lists])]).astype(np.int64)
    floors = None
    if view.tapers:
        nearest = np.where(touches, np.inf, distances).min(axis=1, initial=np.inf)
        largest = splats.opacities * np.exp(-0.5 * nearest**2)
        floors = np.clip(largest, ALPHA_THRESHOLD, thresholds).astype(np.float32)
    return TileBins(tile_start, np.concatenate(lists).astype(np.int32), num_x, num_y, floors)


def _thresholds(splats: Splats, view: View) -> Array:
    """The opacity at which each splat ends."""
    a, _, c = splats.factors.astype(np.float64).T
    weighed = view.threshold * (SHRINK_AREA_PX2 * a * c) ** view.area_power  # √det Σ' = 1 / (a c)
    return np.asarray(np.clip(weighed, min(view.threshold, ALPHA_THRESHOLD), view.threshold))


def _squares_touch(splats: Splats, view: View) -> Array:
    """Whether each splat is listed in each tile by the square around it, [v t]."""
    camera = view.camera
    num_x, num_y = tiles_of(camera)
    a, b, c = splats.factors.astype(np.float64).T
    xx, xy, yy = 1 / a**2 + (b / (a * c)) ** 2, -b / (a * c**2), 1 / c**2  # Σ' from the factor of its inverse
    sides = half_sides(xx, xy, yy, splats.opacities.astype(np.float64), rule_of(view))
    x, y = splats.means_px.astype(np.float64).T
    (left, right), (top, bottom) = tile_range(x, sides, camera.width), tile_range(y, sides, camera.height)
    tile_y, tile_x = (index.ravel() for index in np.indices((num_y, num_x)))
    across = (tile_x >= left[:, None]) & (tile_x < right[:, None])
    down = (tile_y >= top[:, None]) & (tile_y < bottom[:, None])
    return np.asarray(across & down)


def smallest_distances(splats: Splats, camera: Camera) -> Array:
    """Smallest |L d| of each splat over the pixel centres' rectangle of each tile, [v t]."""
    num_x, num_y = tiles_of(camera)
    tile_y, tile_x = (index.ravel() for index in np.indices((num_y, num_x)))
    mx, my = splats.means_px.astype(np.float64).T[:, :, None]
    a, b, c = splats.factors.astype(np.float64).T[:, :, None]
    left, right = TILE_PX * tile_x + 0.5 - mx, np.minimum(TILE_PX * (tile_x + 1), camera.width) - 0.5 - mx
    top, bottom = TILE_PX * tile_y + 0.5 - my, np.minimum(TILE_PX * (tile_y + 1), camera.height) - 0.5 - my

    def distance(dx: Array, dy: Array) -> Array:
        return np.asarray(np.hypot(a * dx + b * dy, c * dy))

    sides = [distance(np.clip(-b / a * dy, left, right), dy) for dy in (top, bottom)]
    sides += [distance(dx, np.clip(-a * b / (b * b + c * c) * dx, top, bottom)) for dx in (left, right)]
    inside = (left <= 0) & (right >= 0) & (top <= 0) & (bottom >= 0)
    return np.asarray(np.where(inside, 0.0, np.minimum.reduce(sides)))
