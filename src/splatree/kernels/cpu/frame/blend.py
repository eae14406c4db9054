"""Blend the splats of each tile front to back: glue over blend.cpp; kernels/reference/blend.py is the definition."""

import numpy as np

from splatree.kernels.cpu import _core
from splatree.scene.cameras import Camera
from splatree.scene.frame import Picture, Splats, TileBins, TileWork
from splatree.scene.options import ResolvedOptions

__all__ = ["blend"]


def blend(
    splats: Splats,
    bins: TileBins,
    camera: Camera,
    options: ResolvedOptions,
    *,
    threads: int = 0,
    contributions: bool = False,
    whole_tile: bool = False,
) -> Picture:
    """The picture of the tiles' lists, on request with the contribution of each pair.

    ``whole_tile`` evaluates a splat in all blocks of a tile instead of those that its ellipse touches: more work, the same
    picture.
    """
    image = np.empty((camera.height, camera.width, 3), np.float32)
    alpha, depth = (np.empty((camera.height, camera.width), np.float32) for _ in range(2))
    work = TileWork(*(np.empty(bins.num_tiles_x * bins.num_tiles_y, np.int64) for _ in range(3)))
    of_pairs = np.empty(bins.num_pairs, np.float32) if contributions else None
    _core.blend_tiles(
        splats.records,
        bins.tile_start,
        bins.splat_from_pair,
        bins.num_tiles_x,
        bins.num_tiles_y,
        options.pixel_threshold,
        bins.floors,
        np.asarray(options.background, np.float64),
        whole_tile,
        image,
        alpha,
        depth,
        of_pairs,
        work.consumed,
        work.evaluated,
        work.blended,
        threads,
    )
    return Picture(image, alpha, depth, work, of_pairs)
