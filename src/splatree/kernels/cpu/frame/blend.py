"""Blend the splats of each tile front to back: glue over blend.cpp; kernels/reference/blend.py is the definition."""

import numpy as np

from splatree.kernels.cpu import _core
from splatree.scene.frame import Picture, Splats, TileBins, TileWork
from splatree.scene.view import View

__all__ = ["blend"]


def blend(splats: Splats, bins: TileBins, view: View, *, threads: int = 0, whole_tile: bool = False) -> Picture:
    """The picture of the tiles' lists, with the outputs that are wanted.

    ``whole_tile`` evaluates a splat in all blocks of a tile instead of those that its ellipse touches: more work, the same
    picture.
    """
    size, wanted = (view.camera.height, view.camera.width), view.wanted
    image = np.empty((*size, 3), np.float32)
    alpha, depth = (np.empty(size, np.float32) for _ in range(2))
    consumed, evaluated, blended = (np.empty(bins.num_tiles_x * bins.num_tiles_y, np.int64) for _ in range(3))
    work = TileWork(consumed, evaluated, blended, is_exact=wanted.last_pair)
    contributions = np.empty(bins.num_pairs, np.float32) if wanted.contributions else None
    last_pair = np.empty(size, np.int64) if wanted.last_pair else None
    median_depth = np.empty(size, np.float32) if wanted.median_depth else None
    _core.blend_tiles(
        splats.records,
        bins.tile_start,
        bins.splat_from_pair,
        bins.num_tiles_x,
        bins.num_tiles_y,
        view.pixel_threshold,
        bins.floors,
        np.asarray(view.background, np.float64),
        whole_tile,
        image,
        alpha,
        depth,
        contributions,
        last_pair,
        median_depth,
        work.consumed,
        work.evaluated,
        work.blended,
        threads,
    )
    return Picture(image, alpha, depth, work, contributions, last_pair, median_depth)
