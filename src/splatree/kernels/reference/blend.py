"""Blend the splats of each tile front to back: the definition.

At a pixel with offset d from the centre of a splat (Kerbl 2023, Eq. 3 and rasterizer):

    α = min(0.99, o exp(−½ |L d|²)), skipped if α < τ
    C ← C + T α c,  D ← D + T α z,  T ← T (1 − α), T = 1 at first

A pixel is finished before a splat that would leave T < 1e-4; that splat is not drawn. The picture is C + T · background, its
alpha 1 − T, its depth D / alpha.
"""

import numpy as np

from splatree.constants import ALPHA_MAX, TILE_PX, TRANSMITTANCE_MIN
from splatree.scene.cameras import Camera
from splatree.scene.frame import Picture, Splats, TileBins, TileWork
from splatree.scene.options import ResolvedOptions

__all__ = ["blend"]


def blend(splats: Splats, bins: TileBins, camera: Camera, options: ResolvedOptions, *, threads: int = 0) -> Picture:
    """The picture of the tiles' lists; ``threads`` is not used."""
    means, factors = splats.means_px.astype(np.float64), splats.factors.astype(np.float64)
    opacities, colors = splats.opacities.astype(np.float64), splats.colors.astype(np.float64)
    depths = splats.depths.astype(np.float64)
    color = np.zeros((camera.height, camera.width, 3))
    depth, transmittance = np.zeros(color.shape[:2]), np.ones(color.shape[:2])
    num_tiles = bins.num_tiles_x * bins.num_tiles_y
    work = TileWork(*(np.zeros(num_tiles, np.int64) for _ in range(3)))

    for tile in range(num_tiles):
        y0, x0 = (TILE_PX * i for i in divmod(tile, bins.num_tiles_x))
        area = np.s_[y0 : y0 + TILE_PX, x0 : x0 + TILE_PX]
        T, C, D = transmittance[area], color[area], depth[area]  # views
        y, x = np.indices(T.shape) + 0.5
        finished = np.zeros(T.shape, bool)
        for i in bins.splat_from_pair[bins.tile_start[tile] : bins.tile_start[tile + 1]]:
            dx, dy = x0 + x - means[i, 0], y0 + y - means[i, 1]
            a, b, c = factors[i]
            alpha = np.minimum(ALPHA_MAX, opacities[i] * np.exp(-0.5 * ((a * dx + b * dy) ** 2 + (c * dy) ** 2)))
            drawn = (alpha >= options.threshold) & ~finished
            work.consumed[tile] += not finished.all()
            work.evaluated[tile] += (~finished).sum()
            finished |= drawn & (T * (1 - alpha) < TRANSMITTANCE_MIN)
            drawn &= ~finished
            weight = np.where(drawn, T * alpha, 0.0)
            C += weight[..., None] * colors[i]
            D += weight * depths[i]
            T[drawn] *= 1 - alpha[drawn]
            work.blended[tile] += drawn.sum()

    alpha = 1 - transmittance
    color += transmittance[..., None] * np.asarray(options.background)
    depth = np.divide(depth, alpha, out=np.zeros_like(depth), where=alpha > 0)
    return Picture(color.astype(np.float32), alpha.astype(np.float32), depth.astype(np.float32), work)
