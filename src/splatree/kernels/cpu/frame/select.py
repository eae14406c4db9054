"""Choose the visible cut by blocks: glue over select.cpp; kernels/reference/select.py is the definition."""

import math
from typing import NamedTuple

import numpy as np

from splatree.constants import CENTRE_PAD, DILATION_PX2, EIGENVALUE_FLOOR_PX4, SIGMAS
from splatree.errors import InputError
from splatree.kernels.cpu import _core
from splatree.kernels.cpu.frame.blocks import index_blocks
from splatree.kernels.cpu.frame.view import PackedView, pack_view
from splatree.scene.gaussians import Gaussians
from splatree.scene.options import SelectOptions
from splatree.scene.tree import BlockIndex, GaussianTree
from splatree.scene.view import View
from splatree.shapes import Array, Bool, Float64, Int32

__all__ = [
    "PackedRule",
    "ancestor_table",
    "is_culled",
    "pack_rule",
    "select",
    "select_by_ancestors",
    "small",
    "view_planes",
    "visible",
]

CULL_BELOW_PX = 1e6
"""Largest τ_R for which blocks are tested against the image: drawn inner nodes reach out of their block by as much."""
BORDER_PX = 1.0
"""Blocks are dropped, or taken for well inside, with this distance to spare (half of it inwards), so that they agree with
what float32 says of their rows."""


def select(
    gaussians: Gaussians,
    tree: GaussianTree,
    blocks: BlockIndex | None,
    view: View,
    options: SelectOptions,
    *,
    runs: Int32[Array, "r 2"] | None = None,
    threads: int = 0,
) -> tuple[Int32[Array, "v"], int]:
    """Rows drawn by the rule `cut`, ascending, and how many rows were looked at.

    With ``runs``, ascending first rows and ends, only rows in one of them are drawn; all others shadow as ever.
    """
    if options.rule != "cut":
        raise InputError(f"select: found rule {options.rule!r}, wanted 'cut'; the others are in NumPy only")
    packed = pack_view(view)
    rows, num_visited = _core.select_cut(
        gaussians,
        tree,
        blocks or index_blocks(gaussians, tree, threads=threads),
        packed,
        view.least_threshold,
        pack_rule(view, options),
        options.view_test,
        is_culled(options),
        runs,
        *view_planes(view, options, packed),
        threads,
    )
    return rows, num_visited


def ancestor_table(tree: GaussianTree) -> Int32[Array, "n l"]:
    """The ancestors of each row, parent first, filled up with −1 (FilterGS §3.2): 4 bytes for each row and level but one."""
    table = np.empty((len(tree), max(tree.num_levels - 1, 0)), np.int32)
    _core.ancestor_table(tree.depth, table)
    return table


def select_by_ancestors(
    gaussians: Gaussians,
    tree: GaussianTree,
    ancestors: Int32[Array, "n l"],
    view: View,
    options: SelectOptions,
    *,
    threads: int = 0,
) -> tuple[Int32[Array, "v"], int]:
    """Rows drawn by the rules `cut`, `paper-strict` or `release`, ascending, and how many were looked at: all.

    Every row is asked on its own with its ancestors from the table, as FilterGS does; the rows are those of `select` and of
    kernels/reference/select.py.
    """
    if options.rule not in ("cut", "paper-strict", "release"):
        raise InputError(f"select_by_ancestors: found rule {options.rule!r}, wanted 'cut', 'paper-strict' or 'release'")
    rows = _core.select_ancestors(
        gaussians,
        tree,
        ancestors,
        pack_view(view),
        view.least_threshold,
        pack_rule(view, options),
        options.view_test,
        options.rule == "cut",
        options.rule == "release",
        threads,
    )
    return rows, len(tree)


def small(
    gaussians: Gaussians,
    tree: GaussianTree,
    rows: Int32[Array, "v"],
    view: View,
    options: SelectOptions,
    *,
    threads: int = 0,
) -> Bool[Array, "v"]:
    """Whether R ≤ τ_R for each of the rows, as `select` decides it."""
    found = np.empty(len(rows), bool)
    _core.small_rows(
        gaussians, tree, rows, pack_view(view), view.least_threshold, pack_rule(view, options), found, threads
    )
    return found


def visible(
    gaussians: Gaussians,
    tree: GaussianTree,
    rows: Int32[Array, "v"],
    view: View,
    options: SelectOptions,
    *,
    threads: int = 0,
) -> Bool[Array, "v"]:
    """Whether each of the rows can be seen, as `select` decides it."""
    if options.view_test == "none":
        return np.ones(len(rows), bool)
    found = np.empty(len(rows), bool)
    packed, rule, named = pack_view(view), pack_rule(view, options), options.view_test
    _core.visible_rows(gaussians, tree, rows, packed, view.least_threshold, rule, named, found, threads)
    return found


def is_culled(options: SelectOptions) -> bool:
    """Whether blocks are tested against the image."""
    return bool(options.view_test != "none" and options.pixel_error < CULL_BELOW_PX)


class PackedRule(NamedTuple):
    """The numbers of the struct SelectRule in shared/select.h, by their names there."""

    limit: float
    """(τ_R / 3)², px²."""
    add: float
    """Variance added to both axes before sizes are compared, px²."""
    least_diagonal: float
    """Least variance of both axes, px²."""
    floor: float
    """Under the root of the larger eigenvalue, px⁴."""
    pixel_error: float
    """τ_R, px."""
    focal_max: float
    """The larger focal length, px."""
    focal_min: float
    """The smaller one, px."""
    k_max: float
    """Standard deviations at which an opacity of 1 falls to τ."""
    logit_min: float
    """Logit of the least opacity that is drawn."""
    pad_x: float
    """Distance outside of the image, along x, at which a centre still counts as inside, px."""
    pad_y: float
    """The same along y."""
    sphere: bool
    """Whether a node's size is that of its sphere."""


def pack_rule(view: View, options: SelectOptions) -> PackedRule:
    """The numbers that the kernels take of the options."""
    camera, dilation_px2, threshold = view.camera, view.dilation_px2, view.least_threshold
    focal = camera.K[0, 0], camera.K[1, 1]
    limit = (options.pixel_error / SIGMAS) ** 2
    added = (0.0, DILATION_PX2) if options.resolved_profile == "ref" else (dilation_px2, 0.0)
    floor = 0.0 if options.resolved_profile == "exact" else EIGENVALUE_FLOOR_PX4
    # Opacities are compared as logits; the slack of 1e-3 covers the rounding of the sigmoid in the projection.
    logit_min = np.log(threshold / (1 - threshold)) - 1e-3
    pads = CENTRE_PAD * camera.width / 2, CENTRE_PAD * camera.height / 2
    sizes = limit, *added, floor, options.pixel_error, max(focal), min(focal), _reach_of_opaque(threshold)
    return PackedRule(*sizes, logit_min, *pads, options.resolved_profile == "sphere")


def _reach_of_opaque(threshold: float) -> float:
    """Standard deviations at which an opacity of 1 falls to the threshold."""
    return float(np.sqrt(-2 * np.log(threshold)))


def view_planes(
    view: View, options: SelectOptions, packed: PackedView
) -> tuple[Float64[Array, "11 4"], Float64[Array, "5"]]:
    """The struct ViewPlanes of cpu/frame/select.h as rows (n, d) of n·p + d, and how far a unit of σ reaches over each side.

    A splat at view coordinates (x, z) with standard deviation s reaches at most k (s (f/z) √(1 + u²) + √h) px from its
    centre f x/z + c, u the largest slope that the Jacobian has; so it is right of the border b if

        f x − (b − c + k √h) z > k f √(1 + u²) s.

    An inner node that is drawn is small, so it reaches at most k √((τ_R / 3)² + h) whatever its s; s is that of the leaves.
    ``packed`` is what `pack_view` made of the view.
    """
    camera = view.camera
    # Plain numbers: arrays of four take three times as long.
    axes = camera.camera_from_world[:3].tolist()  # x, y, z in the camera
    z = axes[2]
    footprint = options.view_test == "footprint"
    k = _reach_of_opaque(view.least_threshold) if footprint else 0.0
    largest = min(options.pixel_error, CULL_BELOW_PX)  # beyond that the sides are not asked
    own_reach = k * math.sqrt((largest / SIGMAS) ** 2 + view.dilation_px2)
    slopes = (
        max(abs(packed.slope_min_x), abs(packed.slope_max_x)),
        max(abs(packed.slope_min_y), abs(packed.slope_max_y)),
    )
    outside, inside, reach = [], [], []
    for axis, size in ((0, camera.width), (1, camera.height)):
        focal, centre = float(camera.K[axis, axis]), float(camera.K[axis, 2])
        margin = -0.5 if footprint else CENTRE_PAD * size / 2
        for sign, border in ((1, size - centre + margin), (-1, centre + margin)):
            outside.append(_plane(sign * focal, axes[axis], border + own_reach + BORDER_PX, z))
            inside.append(_plane(sign * focal, axes[axis], border - BORDER_PX / 2, z))
            reach.append(1.002 * k * focal * math.sqrt(1 + slopes[axis] ** 2))
    near = [0.0, 0.0, 0.0, camera.near]
    planes = [*outside, _plane(0.99, near, 1.0, z), *inside, _plane(1.01, near, 1.0, z), z]
    return np.array(planes, np.float64), np.array([*reach, 0.0])


def _plane(a: float, x: list[float], b: float, y: list[float]) -> list[float]:
    """a x − b y."""
    return [a * one - b * other for one, other in zip(x, y, strict=True)]
