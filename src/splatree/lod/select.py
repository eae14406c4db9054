"""Choose the rows of a scene to draw in a view.

The rule `cut` (kernels/reference/select.py has its definition) runs in the compiled kernel, whose work grows with the blocks
that can be seen, not with the scene. The rules that reproduce published code, `paper-strict`, `release` and `log-serial`,
run in NumPy over all rows: they are there to be compared with.

Rows of clusters that culling leaves out are not drawn; with the rule `exact` they could not be seen anyway.

A budget is met by raising τ_R (lod/budget.py).
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Protocol

import numpy as np

from splatree.clusters.cull import cull
from splatree.constants import DILATION_PX2, EIGENVALUE_FLOOR_PX4, SIGMAS
from splatree.errors import InputError
from splatree.kernels.cpu.frame import select as cpu
from splatree.kernels.cpu.frame.blocks import index_blocks
from splatree.kernels.reference import select as reference
from splatree.lod.budget import meet_budget, meet_budget_from
from splatree.lod.serial import select_serial
from splatree.scene.cameras import Camera
from splatree.scene.clusters import Culling
from splatree.scene.frame import Selection
from splatree.scene.names import Profile
from splatree.scene.options import Cull, RenderOptions, ResolvedOptions, SelectOptions
from splatree.scene.scene import Scene, TileRule
from splatree.scene.tree import GaussianTree
from splatree.shapes import Array, Bool, Int32

__all__ = [
    "Selector",
    "count_nested",
    "count_uncovered",
    "cull_rule",
    "cull_scene",
    "for_levels",
    "in_runs",
    "notes_on",
    "select",
    "smallest_radius",
]


class Selector(Protocol):
    """Anything that chooses the rows of a view of one scene, in the place of `select`: see lod/baselines.py."""

    def __call__(self, camera: Camera, *, dilation_px2: float, threshold: float, threads: int = 0) -> Selection:
        """Choose the rows to draw."""
        ...


def select(
    scene: Scene,
    camera: Camera,
    options: SelectOptions | None = None,
    *,
    dilation_px2: float = DILATION_PX2,
    threshold: float | None = None,
    culling: Culling | None = None,
    last: float | None = None,
    threads: int = 0,
) -> Selection:
    """Choose the rows to draw.

    ``dilation_px2`` is what the drawing adds to each splat's variance; ``threshold`` the opacity τ at which a splat ends (None:
    the scene's), below which the view test `footprint` drops it. ``culling`` is what `cull_scene` found for the same
    camera and options; None: it is found here. ``last`` is the τ_R, px, of the view before, for the budget of a camera that
    moves: the search begins there and is content with 90 % of the budget (lod/budget.py). None: a view alone.

    Raises:
        InputError: a budget that not even the roots in view meet; or a rule of culling for a scene without clusters.
    """
    options = for_levels(options or SelectOptions(), scene)
    if culling is None:
        culling = cull_scene(scene, camera, options, dilation_px2=dilation_px2, threshold=threshold, threads=threads)
    runs = None if culling is None or culling.kept.all() else culling.runs
    threshold = RenderOptions().resolved(scene).least_threshold if threshold is None else threshold
    on_device = scene.device == "cuda" and options.rule == "cut"
    blocks = scene.blocks
    if blocks is None and options.rule == "cut" and not on_device:
        blocks = index_blocks(scene.gaussians, scene.tree, threads=threads)

    choose: Callable[..., tuple[Array, int]] = reference.select
    if options.rule == "cut":
        choose = partial(cpu.select, runs=runs)
    elif options.rule == "log-serial":
        choose = select_serial

    def rows_at(pixel_error: float) -> tuple[Array, int]:
        at = replace(options, pixel_error=pixel_error)
        if on_device:
            rows, visited = _select_on_device(scene, camera, at, dilation_px2, threshold)
        else:
            rows, visited = choose(
                scene.gaussians,
                scene.tree,
                blocks,
                camera,
                at,
                dilation_px2=dilation_px2,
                threshold=threshold,
                threads=threads,
            )
        if runs is not None and (on_device or options.rule != "cut"):
            rows = rows[in_runs(rows, runs)]
        if at.max_radius is not None:
            largest = replace(at, pixel_error=at.max_radius)
            small = cpu.small(
                scene.gaussians, scene.tree, rows, camera, largest, dilation_px2=dilation_px2, threads=threads
            )
            rows = rows[small]
        return rows, visited

    finest, smallest = options.pixel_error, smallest_radius(options.radius, dilation_px2)
    if options.budget is not None and last is not None:
        rows, visited, pixel_error = meet_budget_from(rows_at, options.budget, (finest, smallest), last, camera)
    else:
        rows, visited = rows_at(finest)
        pixel_error = finest
        if options.budget is not None and len(rows) > options.budget:
            coarser = max(finest, smallest)
            rows, visited, pixel_error = meet_budget(rows_at, options.budget, coarser, len(rows), camera)
    notes = notes_on(pixel_error, options.radius, dilation_px2)
    record = scene.tree.record
    if options.radius != "sphere" and pixel_error > 0 and record is not None and record.rule == "linked":
        notes += ("the levels of this scene are linked, not merged: profile 'sphere' changes them region by region",)
    return Selection(rows, options.rule, options.radius, pixel_error, visited, notes)


def for_levels(options: SelectOptions, scene: Scene) -> SelectOptions:
    """The options with the profile that the levels of the scene were made for, unless one is named."""
    if options.profile is not None:
        return options
    record = scene.tree.record
    return replace(options, profile="exact" if record is None else record.profile)


def notes_on(pixel_error: float, profile: Profile, dilation_px2: float) -> tuple[str, ...]:
    """What the caller should know of a selection."""
    smallest = smallest_radius(profile, dilation_px2)
    if not 0 < pixel_error < smallest:
        return ()
    return (
        f"pixel_error {pixel_error:g} px is below {smallest:.3g} px, the smallest radius that profile {profile!r} gives: "
        f"all leaves are drawn",
    )


def cull_rule(scene: Scene, options: SelectOptions | None = None) -> Cull:
    """The rule by which clusters of a scene are left out, from ``options.cull``; `none` if that is not to be done.

    Raises:
        InputError: a rule is named for a scene without clusters.
    """
    rule = (options or SelectOptions()).cull
    if scene.clusters is None:
        if rule not in (None, "none"):
            raise InputError(
                f"cull: found rule {rule!r} for a scene without clusters; make them with splatree build --clusters auto"
            )
        return "none"
    if rule is None:
        # In a tree the selection's blocks leave out as much: they know that drawn inner nodes are small.
        has_levels = scene.blocks is not None and len(scene.blocks.ancestors) > 0
        return "none" if has_levels else "exact"
    return rule


def cull_scene(
    scene: Scene,
    camera: Camera,
    options: SelectOptions | None = None,
    *,
    dilation_px2: float = DILATION_PX2,
    threshold: float | None = None,
    tile_rule: TileRule = "ellipse",
    threads: int = 0,
) -> Culling | None:
    """Decide which clusters of a scene are left out, by its `cull_rule`; None if that is `none`.

    Raises:
        InputError: a rule is named for a scene without clusters.
    """
    rule = cull_rule(scene, options)
    if scene.clusters is None or rule == "none":
        return None
    threshold = scene.threshold if threshold is None else threshold
    return cull(
        scene.clusters,
        camera,
        rule,
        dilation_px2=dilation_px2,
        threshold=threshold,
        tile_rule=tile_rule,
        threads=threads,
    )


def in_runs(rows: Int32[Array, "v"], runs: Int32[Array, "r 2"]) -> Bool[Array, "v"]:
    """Whether each row is in one of the runs: an odd number of their bounds is at or before it."""
    return np.asarray(np.searchsorted(runs.ravel(), rows, side="right") % 2 == 1)


def smallest_radius(profile: Profile, dilation_px2: float = DILATION_PX2) -> float:
    """The radius, px, that a profile gives to a point: with a τ_R below it, levels of detail are off."""
    if profile == "sphere":
        return 0.0
    floor = 0.0 if profile == "exact" else EIGENVALUE_FLOOR_PX4
    dilation = DILATION_PX2 if profile == "ref" else dilation_px2
    return float(SIGMAS * np.sqrt(dilation + np.sqrt(floor)))


def count_nested(tree: GaussianTree, rows: Array) -> int:
    """Selected rows that lie below another selected row, so that both are drawn on top of each other: 0 for a cut."""
    chosen = np.zeros(len(tree), bool)
    chosen[rows] = True
    return int((chosen & reference.shadowed(chosen, tree.subtree_end)).sum())


def count_uncovered(tree: GaussianTree, rows: Array) -> int:
    """Leaves that no selected row stands for, neither themselves nor an ancestor: 0 for a cut, seen and unseen rows together."""
    change = np.zeros(len(tree) + 1, np.int64)
    change[rows] += 1
    np.subtract.at(change, tree.subtree_end[rows], 1)
    return int((tree.is_leaf & (np.cumsum(change[:-1]) == 0)).sum())


def _select_on_device(
    scene: Scene, camera: Camera, options: SelectOptions, dilation_px2: float, threshold: float
) -> tuple[Array, int]:
    from splatree.kernels.cuda.device import renderer_of

    drawing = ResolvedOptions((0.0, 0.0, 0.0), scene.mode, dilation_px2, threshold, 0)
    return renderer_of(scene).select(camera, drawing, replace(options, budget=None, max_radius=None))
