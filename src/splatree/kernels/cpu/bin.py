"""List the splats of each tile: glue over bin.cpp; kernels/reference/bin.py is the definition."""

import numpy as np

from splatree.kernels.cpu import _core
from splatree.scene.cameras import Camera
from splatree.scene.frame import Splats, TileBins, tiles_of
from splatree.scene.options import ResolvedOptions

__all__ = ["bin"]


def bin(
    splats: Splats, camera: Camera, options: ResolvedOptions, *, threads: int = 0, whole_box: bool = False
) -> TileBins:
    """Pairs of splat and tile, tile by tile and nearest first.

    ``whole_box`` lists a splat in all tiles that its box touches instead of those that its ellipse touches: more pairs, the
    same picture.
    """
    num_x, num_y = tiles_of(camera)
    tile_start = np.empty(num_x * num_y + 1, np.int64)
    splat_from_pair = _core.bin_splats(
        splats.records,
        splats.order,
        options.threshold,
        camera.width,
        camera.height,
        tile_start,
        num_x,
        num_y,
        whole_box,
        threads,
    )
    return TileBins(tile_start, splat_from_pair, num_x, num_y)
