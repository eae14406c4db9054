"""List the splats of each tile: glue over bin.cpp; kernels/reference/bin.py is the definition."""

import numpy as np

from splatree.constants import TILE_PX
from splatree.errors import InputError
from splatree.kernels.cpu import _core
from splatree.kernels.cpu.frame.view import pack_square
from splatree.scene.frame import Splats, TileBins, tiles_of
from splatree.scene.view import View

__all__ = ["bin"]

MOST_TILES = 2**16 - 1
"""Rows and columns of tiles are kept in 16 bits."""


def bin(splats: Splats, view: View, *, threads: int = 0, whole_box: bool = False) -> TileBins:
    """Pairs of splat and tile, tile by tile and nearest first.

    ``whole_box`` lists a splat in all tiles that its box touches instead of those that its ellipse touches: more pairs, the
    same picture.
    """
    camera = view.camera
    num_x, num_y = tiles_of(camera)
    if max(num_x, num_y) > MOST_TILES:
        raise InputError(
            f"camera {camera.name!r}: found {camera.width} × {camera.height} px, wanted at most {MOST_TILES * TILE_PX} px a side"
        )
    floors = np.empty(len(splats), np.float32) if view.tapers else None
    tile_start = np.empty(num_x * num_y + 1, np.int64)
    square = pack_square(view)
    splat_from_pair = _core.bin_splats(splats, view, square, whole_box, tile_start, floors, threads)
    return TileBins(tile_start, splat_from_pair, num_x, num_y, floors)
