"""Meet a quality: the coarsest τ_R whose cut is predicted to look as good as asked for.

The quality is a PSNR against all leaves. The levels of a scene know a curve for it (scene/quality.py), which asks two numbers of
a view. Both are sums over the selected nodes, with the area α σ₁ σ₂ (f/z)² of a node on the screen from its two larger axes:

- *merged*, of a cut: the share of the areas that merged nodes have;
- *covered*, of a view: 1 − exp(−1.5 · areas of a tile / 256 px²), the mean over the tiles of 16 × 16 px, from a coarse cut. An
  area is that of all of the Gaussian then, 2π as large, at most that of the tile.

Large selections are summed over a sample of their rows. Cost: a coarse cut, and four to eight cuts.
"""

import math
from collections.abc import Callable, Sized
from dataclasses import dataclass
from typing import Final, TypeVar

import numpy as np

from splatree.constants import DILATION_PX2, TILE_PX
from splatree.errors import InputError
from splatree.scene.cameras import Camera
from splatree.scene.quality import QualityCurve
from splatree.scene.scene import Scene
from splatree.shapes import Array, Bool, Float32, Float64, check_fields

__all__ = [
    "COARSEST_PX",
    "COVERING_PX",
    "Nodes",
    "covered_share",
    "curve_of",
    "merged_share",
    "nodes_of",
    "pixel_error_for",
]

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


Rows = TypeVar("Rows", bound=Sized)
"""Rows of a selection: an array, or where they are (outofcore/paging.py)."""


@dataclass(frozen=True, eq=False)
class Nodes:
    """What the quality of a cut depends on, of some of its nodes."""

    means: Float32[Array, "v 3"]
    """Means, world units."""
    log_scales: Float32[Array, "v 3"]
    """Logarithms of standard deviations, world units."""
    logit_opacities: Float32[Array, "v"]
    """Logits of opacities."""
    is_merged: Bool[Array, "v"]
    """Whether each was made by merging."""

    def __post_init__(self) -> None:
        check_fields(self)


def nodes_of(scene: Scene, rows: Array) -> Nodes:
    """Rows of a scene."""
    g = scene.gaussians
    means, log_scales, logits = (np.take(column, rows, axis=0) for column in (g.means, g.log_scales, g.logit_opacities))
    return Nodes(means, log_scales, logits, scene.tree.subtree_end[rows] > rows + 1)


def pixel_error_for(
    rows_at: Callable[[float], tuple[Rows, int]],
    nodes_at: Callable[[Rows, int], Nodes],
    view: tuple[QualityCurve, Camera],
    quality: float,
    only_leaves: float,
) -> float:
    """The largest τ_R whose cut is predicted to have the quality; 0, all leaves, where no cut of merged nodes has it.

    Args:
        rows_at: the selection at a τ_R, px.
        nodes_at: each n-th of its rows.
        view: the curve of the levels, and the camera.
        quality: PSNR against all leaves that is wanted, dB.
        only_leaves: τ_R below which only leaves are drawn, px.
    """
    curve, camera = view

    def sampled(pixel_error: float) -> tuple[Nodes, int]:
        rows = rows_at(pixel_error)[0]
        step = _step(len(rows))
        return nodes_at(rows, step), step

    covered = _covered(*sampled(COVERING_PX), camera)

    def spare_at(pixel_error: float) -> float:
        """By how much a cut is predicted to be better than asked for, dB."""
        merged = _merged(sampled(pixel_error)[0], camera)
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
    return _merged(nodes_of(scene, rows[:: _step(len(rows))]), camera)


def _merged(nodes: Nodes, camera: Camera) -> float:
    _, squares = _places(nodes, camera)
    areas = _opacities(nodes.logit_opacities) * np.minimum(squares + DILATION_PX2, LARGEST_PX2)
    total = float(areas.sum())
    return float(areas[nodes.is_merged].sum()) / total if total > 0 else 0.0


def covered_share(scene: Scene, rows: Array, camera: Camera) -> float:
    """Share of the picture in which the rows of a coarse cut draw something."""
    step = _step(len(rows))
    return _covered(nodes_of(scene, rows[::step]), step, camera)


def _covered(nodes: Nodes, step: int, camera: Camera) -> float:
    across, down = -(-camera.width // TILE_PX), -(-camera.height // TILE_PX)
    places, squares = _places(nodes, camera)
    inside = ((places >= 0) & (places < (camera.width, camera.height))).all(axis=1)
    tiles = (places[inside] // TILE_PX).astype(np.int64)
    areas = _opacities(nodes.logit_opacities[inside]) * np.minimum(2 * np.pi * squares[inside], TILE_PX**2)
    sums = np.bincount(tiles[:, 1] * across + tiles[:, 0], areas, minlength=across * down)
    return float(np.mean(1 - np.exp(-1.5 * step * sums / TILE_PX**2)))


def _step(num_rows: int) -> int:
    """Each n-th row is in the sample."""
    return num_rows // SAMPLE + 1


def _opacities(logits: Array) -> Float64[Array, "v"]:
    with np.errstate(over="ignore"):
        return np.asarray(1 / (1 + np.exp(-logits.astype(np.float64))))


def _places(nodes: Nodes, camera: Camera) -> tuple[Float64[Array, "v 2"], Float64[Array, "v"]]:
    """Centres of the nodes in the picture, px, and σ₁ σ₂ (f/z)² of their two larger axes, px²."""
    pose, focal = camera.camera_from_world, camera.K[[0, 1], [0, 1]]
    seen = nodes.means @ pose[:3, :3].T + pose[:3, 3]
    depths = np.maximum(seen[:, 2], camera.near)
    log_scales = nodes.log_scales.astype(np.float64)
    larger_two = log_scales.sum(axis=1) - log_scales.min(axis=1)
    with np.errstate(over="ignore"):
        squares = np.exp(larger_two) * (focal.prod() / depths**2)
        places = seen[:, :2] * (focal / depths[:, None]) + camera.K[:2, 2]
    return places, squares
