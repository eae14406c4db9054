"""Meet a quality: the coarsest τ_R whose cut is predicted to look as good as asked for.

The quality is a PSNR against all leaves. The levels of a scene know a curve for it (scene/quality.py), which asks two numbers of
a view. Both are sums over the selected nodes, with the area α σ₁ σ₂ (f/z)² of a node on the screen from its two larger axes:

- *merged*, of a cut: the share of the areas that merged nodes have;
- *covered*, of a view: 1 − exp(−1.5 · areas of a tile / 256 px²), the mean over the tiles of 16 × 16 px, from a coarse cut. An
  area is that of all of the Gaussian then, 2π as large, at most that of the tile.

Large selections are summed over a sample of their rows. Cost: a coarse cut, and four to eight cuts.
"""

import math
from collections.abc import Callable
from typing import Final

import numpy as np

from splatree.constants import DILATION_PX2, TILE_PX
from splatree.errors import InputError
from splatree.scene.cameras import Camera
from splatree.scene.quality import QualityCurve
from splatree.scene.scene import Scene
from splatree.shapes import Array, Float64

__all__ = ["COARSEST_PX", "COVERING_PX", "covered_share", "curve_of", "merged_share", "pixel_error_for"]

COVERING_PX: Final = 12.0
"""τ_R of the cut by which a view is found to be covered: few nodes, which are still smaller than a tile."""

COARSEST_PX: Final = 24.0
"""No coarser cut is chosen for a quality: curves are fitted to finer ones."""

FINEST_PX: Final = 0.25
"""For extents, which may be of any size: below it all leaves are drawn."""

PRECISION_DB: Final = 0.25
"""A cut whose predicted quality is within this of what is asked for is not searched further."""

TRIALS: Final = 8
"""Most cuts that are tried: each halves the range of ln τ_R at least roughly, which is 4.6 at most."""

SAMPLE: Final = 40_000
"""Rows summed over, evenly spread: where a hundredth is merged, its share is found to a tenth, half a dB."""

LARGEST_PX2: Final = 1e4
"""Area on the screen above which a node counts no more: it reaches beyond the picture."""


def pixel_error_for(
    rows_at: Callable[[float], tuple[Array, int]], scene: Scene, camera: Camera, quality: float, only_leaves: float
) -> float:
    """The largest τ_R whose cut is predicted to have the quality; 0, all leaves, where no cut of merged nodes has it.

    Args:
        rows_at: the selection at a τ_R, px.
        scene: what is selected from.
        camera: the view.
        quality: PSNR against all leaves that is wanted, dB.
        only_leaves: τ_R below which only leaves are drawn, px.

    Raises:
        InputError: the levels have no curve of their quality.
    """
    curve = curve_of(scene)
    covered = covered_share(scene, rows_at(COVERING_PX)[0], camera)

    def spare_at(pixel_error: float) -> float:
        """By how much a cut is predicted to be better than asked for, dB."""
        merged = merged_share(scene, rows_at(pixel_error)[0], camera)
        return curve.psnr(pixel_error, merged=merged, covered=covered) - quality

    fine, coarse = math.log(max(1.02 * only_leaves, FINEST_PX)), math.log(COARSEST_PX)
    spare, lack = spare_at(math.exp(fine)), spare_at(COARSEST_PX)
    if lack >= 0:
        return COARSEST_PX
    if spare < 0:
        return 0.0
    for _ in range(TRIALS):
        share = spare / (spare - lack) if math.isfinite(spare) else 0.5
        middle = fine + min(max(share, 0.15), 0.85) * (coarse - fine)
        found = spare_at(math.exp(middle))
        if found >= 0:
            fine, spare = middle, found
            if found < PRECISION_DB:
                break
        else:
            coarse, lack = middle, found
    return math.exp(fine)


def curve_of(scene: Scene) -> QualityCurve:
    """The curve that the levels of a scene have."""
    record = scene.tree.record
    if record is None or record.quality is None:
        raise InputError(
            "quality: found levels whose quality was not measured, wanted a curve of it; build them with splatree build, "
            "call with_quality, or use pixel_error or budget"
        )
    return record.quality


def merged_share(scene: Scene, rows: Array, camera: Camera) -> float:
    """Share of the areas of selected rows on the screen that merged nodes have."""
    rows = rows[:: _step(rows)]
    _, squares = _places(scene, rows, camera)
    areas = _opacities(scene, rows) * np.minimum(squares + DILATION_PX2, LARGEST_PX2)
    is_merged = scene.tree.subtree_end[rows] > rows + 1
    total = float(areas.sum())
    return float(areas[is_merged].sum()) / total if total > 0 else 0.0


def covered_share(scene: Scene, rows: Array, camera: Camera) -> float:
    """Share of the picture in which the rows of a coarse cut draw something."""
    across, down = -(-camera.width // TILE_PX), -(-camera.height // TILE_PX)
    step = _step(rows)
    rows = rows[::step]
    places, squares = _places(scene, rows, camera)
    inside = ((places >= 0) & (places < (camera.width, camera.height))).all(axis=1)
    tiles = (places[inside] // TILE_PX).astype(np.int64)
    areas = _opacities(scene, rows[inside]) * np.minimum(2 * np.pi * squares[inside], TILE_PX**2)
    sums = np.bincount(tiles[:, 1] * across + tiles[:, 0], areas, minlength=across * down)
    return float(np.mean(1 - np.exp(-1.5 * step * sums / TILE_PX**2)))


def _step(rows: Array) -> int:
    """Each n-th row is in the sample."""
    return len(rows) // SAMPLE + 1


def _opacities(scene: Scene, rows: Array) -> Float64[Array, "v"]:
    with np.errstate(over="ignore"):
        return np.asarray(1 / (1 + np.exp(-scene.gaussians.logit_opacities[rows].astype(np.float64))))


def _places(scene: Scene, rows: Array, camera: Camera) -> tuple[Float64[Array, "v 2"], Float64[Array, "v"]]:
    """Centres of the rows in the picture, px, and σ₁ σ₂ (f/z)² of their two larger axes, px²."""
    pose, focal = camera.camera_from_world, camera.K[[0, 1], [0, 1]]
    seen = np.take(scene.gaussians.means, rows, axis=0) @ pose[:3, :3].T + pose[:3, 3]
    depths = np.maximum(seen[:, 2], camera.near)
    log_scales = np.take(scene.gaussians.log_scales, rows, axis=0).astype(np.float64)
    larger_two = log_scales.sum(axis=1) - log_scales.min(axis=1)
    with np.errstate(over="ignore"):
        squares = np.exp(larger_two) * (focal.prod() / depths**2)
        places = seen[:, :2] * (focal / depths[:, None]) + camera.K[:2, 2]
    return places, squares
