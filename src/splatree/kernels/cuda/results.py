"""What a frame leaves on a device, as the structs of the stages."""

from typing import Any

import numpy as np

from splatree.kernels.cuda import plan
from splatree.kernels.cuda.workspace import Workspace
from splatree.scene.cameras import Camera
from splatree.scene.frame import PIXEL_OUTPUTS, Splats, TileBins, TileWork, tiles_of
from splatree.scene.view import View
from splatree.shapes import Array, Bool, Int32

__all__ = ["prepare_outputs", "read_bins", "read_outputs", "read_splats", "tile_work_of"]


def prepare_outputs(work: Workspace, view: View, num_pairs: int) -> None:
    """Make room for what is wanted beside colour, alpha and depth; kernels of pixels write both of their outputs."""
    if view.wanted.contributions:
        work.ensure("contributions", num_pairs).clear()
    if view.wanted.of_pixels:
        for name in PIXEL_OUTPUTS:
            work.ensure(name, view.camera.width * view.camera.height)


def read_outputs(work: Workspace, view: View, num_pairs: int) -> dict[str, Any]:
    """The fields of `Picture` beside colour, alpha and depth."""
    wanted, size = view.wanted, (view.camera.height, view.camera.width)
    assert work.sizes is not None
    counts = work.arrays["tile_work"].numpy(3 * work.sizes.num_tiles)
    outputs: dict[str, Any] = {"tiles": tile_work_of(counts, is_exact=wanted.last_pair)}

    if wanted.contributions:
        outputs["contributions"] = np.ascontiguousarray(work.arrays["contributions"].numpy(num_pairs)[:, 0])
    for name, kind in PIXEL_OUTPUTS.items():
        if getattr(wanted, name):
            outputs[name] = work.arrays[name].numpy(size[0] * size[1]).reshape(size).astype(kind)
    return outputs


def tile_work_of(counts: Array, *, is_exact: bool = False) -> TileWork:
    """What the blend did in each tile, from the array `tile_work`."""
    consumed, evaluated, blended = np.ascontiguousarray(counts.reshape(-1, 3).T.astype(np.int64))
    return TileWork(consumed, evaluated, blended, is_exact=is_exact)


def read_splats(work: Workspace, rows: Int32[Array, "v"]) -> tuple[Splats, Bool[Array, "v"]]:
    """The visible splats of the rows, and which of the rows they come from."""
    visible = work.arrays["depth_keys"].numpy(len(rows))[:, 0] != 0xFFFFFFFF
    records = work.arrays["records"].numpy(4 * len(rows)).reshape(-1, 16)[visible]
    order = work.arrays["order"].numpy(int(visible.sum()))[:, 0]
    return Splats(rows[visible], records, _renumbered(visible)[order]), visible


def read_bins(work: Workspace, camera: Camera, visible: Bool[Array, "v"], num_rows: int) -> TileBins:
    """The lists of the tiles, of the visible rows."""
    assert work.sizes is not None
    num_x, num_y = tiles_of(camera)
    start = work.arrays["tile_start"].numpy(num_x * num_y + 1)[:, 0].astype(np.int64)
    side = "values_b" if plan.pair_side(work.sizes) else "values_a"
    slots = work.arrays[side].numpy(int(start[-1]))[:, 0]
    floors = work.arrays["floors"].numpy(num_rows)[visible, 0] if work.sizes.tapers else None
    return TileBins(start, _renumbered(visible)[slots], num_x, num_y, floors)


def _renumbered(visible: Bool[Array, "v"]) -> Int32[Array, "v"]:
    """The place of each row among those that are visible."""
    return (np.cumsum(visible) - 1).astype(np.int32)
