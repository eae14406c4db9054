"""Blend the splats of each tile front to back: glue over blend.cpp; kernels/reference/blend.py is the definition."""

import numpy as np

from splatree.kernels.cpu import _core
from splatree.scene.frame import PIXEL_OUTPUTS, Picture, Splats, TileBins, TileWork
from splatree.scene.view import View
from splatree.shapes import Array

__all__ = ["blend"]


def blend(splats: Splats, bins: TileBins, view: View, *, threads: int = 0, whole_tile: bool = False) -> Picture:
    """The picture of the tiles' lists, with the outputs that are wanted.

    ``whole_tile`` evaluates a splat in all cells of a tile, of 4 × 4 px each, instead of those that its ellipse touches: more
    work, the same picture.
    """
    size, wanted, num_tiles = (view.camera.height, view.camera.width), view.wanted, len(bins.tile_start) - 1
    outputs: dict[str, Array] = {"image": np.empty((*size, 3), np.float32)}
    outputs["alpha"] = np.empty(size, np.float32)
    if wanted.depth or wanted.contributions or wanted.of_pixels:
        outputs["depth"] = np.empty(size, np.float32)
    if wanted.contributions:
        outputs["contributions"] = np.empty(bins.num_pairs, np.float32)
    outputs |= {name: np.empty(size, kind) for name, kind in PIXEL_OUTPUTS.items() if getattr(wanted, name)}
    work = {name: np.empty(num_tiles, np.int64) for name in ("consumed", "evaluated", "blended")}
    _core.blend_tiles(splats, bins, view, whole_tile, outputs | work, threads)
    depth = outputs.pop("depth", None)
    return Picture(depth=depth, tiles=TileWork(**work, is_exact=wanted.last_pair), **outputs)
