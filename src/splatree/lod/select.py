"""Choose the rows of a scene to draw in a view.

The rule `cut` (kernels/reference/select.py has its definition) runs in the compiled kernel, whose work grows with the blocks
that can be seen, not with the scene. The rules that reproduce published code, `paper-strict`, `release` and `log-serial`,
run in NumPy over all rows: they are there to be compared with.

Rows of clusters that culling leaves out are not drawn; with the rule `exact` they could not be seen anyway.

A budget is met by raising τ_R (lod/budget.py). A quality chooses τ_R by what cuts of the view look like (lod/quality.py).
"""

from collections.abc import Callable, Sized
from dataclasses import replace
from functools import partial
from typing import Protocol, TypeVar

import numpy as np

from splatree.clusters.cull import cull
from splatree.constants import DILATION_PX2, EIGENVALUE_FLOOR_PX4, SIGMAS
from splatree.errors import InputError
from splatree.kernels.contract import FrameStages
from splatree.kernels.cpu.frame import select as cpu
from splatree.kernels.cpu.frame import stages as cpu_stages
from splatree.kernels.cpu.frame.blocks import index_blocks
from splatree.kernels.reference import select as reference
from splatree.lod.budget import fill_budget, meet_budget, meet_budget_from
from splatree.lod.occlusion import Cover, blurred, cover_of, first_look, light_of, select_eased
from splatree.lod.quality import Gauge
from splatree.lod.serial import select_serial
from splatree.scene.arguments import checked
from splatree.scene.cameras import Camera
from splatree.scene.clusters import Culling
from splatree.scene.frame import CutRange, Selection
from splatree.scene.given import given
from splatree.scene.names import EXTENT_PROFILES, Profile
from splatree.scene.options import Cull, SelectOptions
from splatree.scene.scene import Scene
from splatree.scene.tree import BlockIndex, GaussianTree
from splatree.scene.view import View, view_of
from splatree.shapes import Array

__all__ = [
    "Selector",
    "count_nested",
    "count_uncovered",
    "cull_rule",
    "cull_scene",
    "for_levels",
    "notes_on",
    "select",
    "smallest_radius",
    "within_budget",
]


LEAST_SHARE, SAMPLE_BLOCKS = 32, 256
"""The τ_R of a budget is guessed from one of so many blocks, or from so many blocks if these are more."""


class Selector(Protocol):
    """Anything that chooses the rows of a view of one scene, in the place of `select`: see lod/baselines.py."""

    def __call__(self, view: View, *, threads: int = 0) -> Selection:
        """Choose the rows to draw."""
        ...


@checked
def select(
    scene: Scene,
    view: Camera | View,
    options: SelectOptions | None = None,
    *,
    culling: Culling | None = None,
    last: float | None = None,
    near: float | None = None,
    stages: FrameStages | None = None,
    threads: int = 0,
) -> Selection:
    """Choose the nodes to draw in a view.

    Args:
        scene: what is chosen from. Without ``blocks`` its index is made at each call (`lod.blocks.with_blocks` keeps it).
        view: a camera, for drawing with the options that the scene itself has; or a view, whose dilation and τ the view test
            `footprint` takes into account.
        options: pixel error, budget or quality, rule, profile and view test; None: the defaults.
        culling: what `cull_scene` found for the same view and options; None: it is found here.
        last: τ_R, px, of the view before, for the budget or the quality of a camera that moves: the search begins there, and for
            a budget is content with 90 % of it (lod/budget.py). None: a view alone, as with occlusion.
        near: τ_R, px, of a view nearby, where a budget is looked for first. It saves time and changes no row.
        stages: the back end that selects by the rule `cut`; None: the CPU.
        threads: threads to use; 0: all. The result is the same for any number.

    Returns:
        The selected rows, ascending, with the τ_R that chose them.

    Raises:
        InputError: more roots are in view than the budget allows, or a rule of culling was named for a scene without clusters.

    Source:
        FilterGS (Wang 2026), §3.2, for the cut without a traversal; docs/explanation/select.md.

    Example:
        >>> all_leaves = st.select(scene, camera, st.SelectOptions(pixel_error=0))
        >>> len(st.select(scene, camera)) <= len(all_leaves)
        True
    """
    if not isinstance(view, View):
        view = view_of(scene, view)
    options = for_levels(given(options, SelectOptions, "select"), scene)
    if options.quality is not None:
        options = _measured(scene, view, options, last, threads=threads)
    if culling is None:
        culling = cull_scene(scene, view, options, threads=threads)
    runs = None if culling is None or culling.kept.all() else culling.runs
    blocks = scene.blocks
    choose: Callable[..., tuple[Array, int]] = reference.select
    if options.rule == "cut":
        choose = cpu.select if stages is None else stages.select
        if stages is None and blocks is None:
            blocks = index_blocks(scene.gaussians, scene.tree, threads=threads)
    elif options.rule == "log-serial":
        choose = select_serial

    def rows_at(pixel_error: float) -> tuple[Array, int]:
        at = replace(options, pixel_error=pixel_error)
        rows, visited = choose(scene.gaussians, scene.tree, blocks, view, at, runs=runs, threads=threads)
        if at.max_radius is not None:
            largest = replace(at, pixel_error=at.max_radius)
            rows = rows[cpu.small(scene.gaussians, scene.tree, rows, view, largest, threads=threads)]
        return rows, visited

    find_range = getattr(cpu if stages is None else stages, "select_range", None)

    if options.occlusion:  # the search is of another cut than the last τ_R
        last = near = None

    def plain(options: SelectOptions) -> tuple[Array, int, float]:
        if options.budget is None or last is not None or find_range is None or options.rule != "cut":
            return within_budget(rows_at, view, options, options.pixel_error, last=last)
        find = partial(find_range, scene.gaussians, scene.tree, blocks, view, runs=runs, threads=threads)
        every = _sampled(blocks)
        range_at = partial(_range_at, find, scene, view, options, threads)
        return fill_budget(range_at, rows_at, options, options.pixel_error, view.camera, every=every, near=near)

    if options.occlusion:
        rows, visited, pixel_error = _eased(scene, view, options, plain, runs, threads)
    else:
        rows, visited, pixel_error = plain(options)
    notes = notes_on(scene, options, pixel_error, view)
    return Selection(rows, options.rule, options.resolved_profile, pixel_error, visited, notes)


def _range_at(
    find: Callable[..., CutRange],
    scene: Scene,
    view: View,
    options: SelectOptions,
    threads: int,
    finest: float,
    coarsest: float,
    every: int = 1,
) -> CutRange:
    """The cuts from one τ_R to another, px, of nodes that are not too large to be drawn."""
    found = find(replace(options, pixel_error=finest), coarsest=coarsest, every=every)
    if options.max_radius is None:
        return found
    largest = replace(options, pixel_error=options.max_radius)
    is_left = cpu.small(scene.gaussians, scene.tree, found.rows, view, largest, threads=threads)
    return CutRange(found.rows[is_left], found.enters[is_left], found.leaves[is_left], found.num_visited)


def _eased(
    scene: Scene,
    view: View,
    options: SelectOptions,
    plain: Callable[[SelectOptions], tuple[Array, int, float]],
    runs: Array | None,
    threads: int,
) -> tuple[Array, int, float]:
    """The rows of a cut that has fewer nodes where things are hidden (lod/occlusion.py), on the processor."""
    blocks = scene.blocks or index_blocks(scene.gaussians, scene.tree, threads=threads)
    find = partial(cpu.select_range, scene.gaussians, scene.tree, blocks, view, runs=runs, threads=threads)

    def look(rows: Array, coarser: CutRange, limits: tuple[float, float]) -> Cover:
        small = first_look(view)
        sharp = cpu_stages.project(scene.gaussians, scene.ids, rows, small, curves=scene.tree.curves, threads=threads)
        splats = blurred(sharp)
        bins = cpu_stages.bin(splats, small, threads=threads)
        contributions = cpu_stages.blend(splats, bins, small, threads=threads).contributions
        assert contributions is not None
        light = light_of(splats, bins, contributions, small)
        return cover_of(light, coarser, limits, scene.tree.subtree_end)

    range_at = partial(_range_at, find, scene, view, options, threads)
    return select_eased(plain, range_at, look, options, every=_sampled(blocks))


def _sampled(blocks: BlockIndex | None) -> int:
    """Of so many blocks one is looked at to guess the τ_R of a budget."""
    return 1 if blocks is None else min(LEAST_SHARE, max(1, len(blocks) // SAMPLE_BLOCKS))


def _measured(scene: Scene, view: View, options: SelectOptions, last: float | None, *, threads: int) -> SelectOptions:
    """The options with the τ_R that has their quality: pictures are drawn on the processor."""

    def draw(part: View, by_size: SelectOptions) -> Array:
        rows = select(scene, part, by_size, threads=threads).rows
        splats = cpu_stages.project(scene.gaussians, scene.ids, rows, part, curves=scene.tree.curves, threads=threads)
        return cpu_stages.blend(splats, cpu_stages.bin(splats, part, threads=threads), part, threads=threads).image

    point_px = smallest_radius(options.resolved_profile, view.dilation_px2)
    return Gauge(draw).settled(options, view, point_px=point_px, last=last)


Rows = TypeVar("Rows", bound=Sized)
"""Rows of a selection: an array, or where they are (outofcore/paging.py)."""


def within_budget(
    rows_at: Callable[[float], tuple[Rows, int]],
    view: View,
    options: SelectOptions,
    finest: float,
    *,
    last: float | None = None,
) -> tuple[Rows, int, float]:
    """The rows at the finest τ_R that the budget of the options allows, how many were looked at, and this τ_R, px.

    Args:
        rows_at: the rows at a τ_R, px, and how many were looked at.
        view: the view.
        options: with the profile of the levels; without a budget the rows are those at ``finest``.
        finest: finest τ_R that is wanted, px.
        last: τ_R, px, of the view before.

    Raises:
        InputError: more roots are in view than the budget allows.
    """
    smallest = smallest_radius(options.resolved_profile, view.dilation_px2)
    if options.budget is not None and last is not None:
        return meet_budget_from(rows_at, options.budget, (finest, smallest), last, view.camera)
    rows, visited = rows_at(finest)
    if options.budget is None or len(rows) <= options.budget:
        return rows, visited, finest
    return meet_budget(rows_at, options.budget, max(finest, smallest), len(rows), view.camera)


def for_levels(options: SelectOptions, scene: Scene) -> SelectOptions:
    """The options with the profile that the levels of the scene were made for, unless one is named."""
    if options.profile is not None:
        return options
    record = scene.tree.record
    return replace(options, profile="exact" if record is None else record.profile)


def notes_on(scene: Scene, options: SelectOptions, pixel_error: float, view: View) -> tuple[str, ...]:
    """What the caller should know of a selection by a τ_R of ``pixel_error``, px."""
    notes: tuple[str, ...] = ()
    profile, record = options.resolved_profile, scene.tree.record
    smallest = smallest_radius(profile, view.dilation_px2)
    if 0 < pixel_error < smallest:
        notes += (
            f"pixel_error {pixel_error:g} px is below {smallest:.3g} px, the smallest radius that profile {profile!r} gives: "
            f"all leaves are drawn",
        )
    if profile not in EXTENT_PROFILES and pixel_error > 0 and record is not None and record.rule == "linked":
        notes += ("the levels of this scene are linked, not merged: profile 'sphere' changes them region by region",)
    return notes


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


def cull_scene(scene: Scene, view: View, options: SelectOptions | None = None, *, threads: int = 0) -> Culling | None:
    """Decide which clusters of a scene are left out, by its `cull_rule`; None if that is `none`.

    Raises:
        InputError: a rule is named for a scene without clusters.
    """
    rule = cull_rule(scene, options)
    if scene.clusters is None or rule == "none":
        return None
    return cull(scene.clusters, view, rule, threads=threads)


def smallest_radius(profile: Profile, dilation_px2: float = DILATION_PX2) -> float:
    """The radius, px, that a profile gives to a point: with a τ_R below it, levels of detail are off."""
    if profile in EXTENT_PROFILES:
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
