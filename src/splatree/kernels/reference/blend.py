"""Blend the splats of each tile front to back: the definition.

At a pixel with offset d from the centre of a splat (Kerbl 2023, Eq. 3 and rasterizer):

    α = min(0.99, o exp(−½ |L d|²)), skipped if α < θ
    C ← C + T α c,  D ← D + T α z,  T ← T (1 − α), T = 1 at first
    K ← K + T α of the pair, its contribution KPC (FilterGS 2026, Eq. 5)

A pixel is finished before a splat that would leave T < 1e-4; that splat is not drawn. Where `View.least_light` is above 0, it is
finished once T is below that instead, and the splat that brought it there is drawn. The picture is C + T · background, its
alpha 1 − T, its depth D / alpha.

Splats shrunk to τ > 1/255 are drawn whole in the tiles that they keep (θ = 1/255, as the code of FilterGS), which ends them at
edges of tiles; or tapered off towards their floor β, the largest opacity in a tile that they lost (θ = β, bin.py):

    α' = min(α, 2 (α − β) + 1/255)

which is 1/255 where the first lost tile may begin, as at the rim of any splat, and α from 2 β on.

Other outputs, where they are wanted: the last pair that a pixel blended, −1 if none; and the depth of the splat at which its T
falls below ½, 0 if it never does.
"""

import numpy as np

from splatree.constants import ALPHA_MAX, TAPER_SLOPE, TILE_PX, TRANSMITTANCE_MIN
from splatree.scene.frame import Picture, Splats, TileBins, TileWork
from splatree.scene.view import View

__all__ = ["blend"]

HALF = 0.5
"""The transmittance below which more than half of the light is stopped."""


def blend(splats: Splats, bins: TileBins, view: View, *, threads: int = 0) -> Picture:
    """The picture of the tiles' lists, with the outputs that are wanted; ``threads`` is not used."""
    camera, wanted = view.camera, view.wanted
    means, factors = splats.means_px.astype(np.float64), splats.factors.astype(np.float64)
    opacities, colors = splats.opacities.astype(np.float64), splats.colors.astype(np.float64)
    depths = splats.depths.astype(np.float64)
    color = np.zeros((camera.height, camera.width, 3))
    depth, transmittance = np.zeros(color.shape[:2]), np.ones(color.shape[:2])
    last_pair, median_depth = np.full(color.shape[:2], -1), np.zeros(color.shape[:2])
    num_tiles = bins.num_tiles_x * bins.num_tiles_y
    consumed, evaluated, blended = (np.zeros(num_tiles, np.int64) for _ in range(3))
    work = TileWork(consumed, evaluated, blended, is_exact=True)
    of_pairs = np.zeros(bins.num_pairs)
    floors = bins.floors if bins.floors is not None else np.full(len(splats), view.pixel_threshold)

    for tile in range(num_tiles):
        y0, x0 = (TILE_PX * i for i in divmod(tile, bins.num_tiles_x))
        area = np.s_[y0 : y0 + TILE_PX, x0 : x0 + TILE_PX]
        T, C, D = transmittance[area], color[area], depth[area]  # views
        y, x = np.indices(T.shape) + 0.5
        finished = np.zeros(T.shape, bool)
        for pair in range(bins.tile_start[tile], bins.tile_start[tile + 1]):
            i = bins.splat_from_pair[pair]
            dx, dy = x0 + x - means[i, 0], y0 + y - means[i, 1]
            a, b, c = factors[i]
            whole = opacities[i] * np.exp(-0.5 * ((a * dx + b * dy) ** 2 + (c * dy) ** 2))
            alpha = np.minimum(ALPHA_MAX, np.minimum(whole, TAPER_SLOPE * (whole - floors[i]) + view.pixel_threshold))
            drawn = (whole >= floors[i]) & ~finished
            work.consumed[tile] += not finished.all()
            work.evaluated[tile] += (~finished).sum()
            if not view.least_light:
                finished |= drawn & (T * (1 - alpha) < TRANSMITTANCE_MIN)
            drawn &= ~finished
            weight = np.where(drawn, T * alpha, 0.0)
            C += weight[..., None] * colors[i]
            D += weight * depths[i]
            median_depth[area][drawn & (T >= HALF) & (T * (1 - alpha) < HALF)] = depths[i]
            T[drawn] *= 1 - alpha[drawn]
            finished |= view.least_light > T
            last_pair[area][drawn] = pair
            work.blended[tile] += drawn.sum()
            of_pairs[pair] = weight.sum()

    alpha = 1 - transmittance
    color += transmittance[..., None] * np.asarray(view.background)
    depth = np.divide(depth, alpha, out=np.zeros_like(depth), where=alpha > 0)
    return Picture(
        color.astype(np.float32),
        alpha.astype(np.float32),
        depth.astype(np.float32) if wanted.depth else None,
        work,
        of_pairs.astype(np.float32) if wanted.contributions else None,
        last_pair if wanted.last_pair else None,
        median_depth.astype(np.float32) if wanted.median_depth else None,
    )
