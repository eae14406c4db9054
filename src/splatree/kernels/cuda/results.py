"""What the stages leave on a device, as their structs."""

import math
from typing import Any

import numpy as np

from splatree.kernels.cuda import plan
from splatree.kernels.cuda.workspace import Workspace
from splatree.kernels.reference.optimise import COLUMNS
from splatree.scene.cameras import Camera
from splatree.scene.frame import PIXEL_OUTPUTS, Splats, TileBins, TileWork, tiles_of
from splatree.scene.gaussians import Gaussians
from splatree.scene.gradients import GaussianGradients, PictureGradients, SplatGradients
from splatree.scene.view import View
from splatree.shapes import Array, Bool, Float32, Int32

__all__ = [
    *(
        "NUM_SUMS",
        "prepare_outputs",
        "read_bins",
        "read_gradients",
        "read_outputs",
        "read_splats",
        "read_sums",
        "sums_of",
    ),
    *("tile_work_of", "width_of"),
]

NUM_SUMS = 12
"""Of a pair and of a splat: six moments, three colours, depth, weight, error (SplatSum in shared/sums.h)."""


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


def read_sums(work: Workspace, num_splats: int, upstream: PictureGradients) -> SplatGradients:
    """The sums over the pixels of each splat, those that were asked for."""
    sums = work.arrays["splat_sums"].numpy(NUM_SUMS * num_splats).reshape(num_splats, NUM_SUMS)
    has_errors = upstream.errors is not None
    return SplatGradients(
        sums[:, :6].copy(),
        sums[:, 6:9].copy(),
        None if upstream.depth is None else sums[:, 9].copy(),
        sums[:, 10].copy() if has_errors else None,
        sums[:, 11].copy() if has_errors else None,
    )


def sums_of(gradients: SplatGradients) -> Float32[Array, "v 12"]:
    """The sums side by side, as `project_backward` reads them."""
    sums = np.zeros((len(gradients.moments), NUM_SUMS), np.float32)
    sums[:, :6], sums[:, 6:9] = gradients.moments, gradients.colors
    if gradients.depths is not None:
        sums[:, 9] = gradients.depths
    return sums


def read_gradients(work: Workspace, rows: Int32[Array, "v"], gaussians: Gaussians) -> GaussianGradients:
    """The derivatives by the columns of the rows."""
    columns = []
    for name in COLUMNS:
        found = work.arrays[f"by_{name}"].numpy(len(rows) * width_of(gaussians, name))
        columns.append(found.reshape(len(rows), *getattr(gaussians, name).shape[1:]))
    return GaussianGradients(rows, *columns)


def width_of(gaussians: Gaussians, name: str) -> int:
    """Numbers of a row in a column."""
    return math.prod(getattr(gaussians, name).shape[1:])


def _renumbered(visible: Bool[Array, "v"]) -> Int32[Array, "v"]:
    """The place of each row among those that are visible."""
    return (np.cumsum(visible) - 1).astype(np.int32)
