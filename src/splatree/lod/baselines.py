"""Published methods of selection over one tree: each is a `Selector`, drawn and timed as ours is.

The methods were published with trees, trainings and renderers of their own. Here only their rule is kept: which nodes of *one*
tree does it draw? That compares selections on equal terms, and says nothing about how well each method trains.

================  ==================================================================================================
3dgs              all leaves; nothing is chosen (Kerbl 2023)
roots, depth      one depth of the tree everywhere: nodes of that depth, and leaves above it
h3dgs             size(v) < limit <= size(parent), size = longest side of the nested box / distance from it (Kerbl 2024, §4.2)
serial            the exact cut, level by level: what `select` is held to (lod/serial.py)
log-serial        the same as LoG's code decides (Shuai 2024; lod/serial.py)
octree            depth of the tree from the distance, L = log2(d_std / d) rounded (Octree-GS, Ren 2024, §4.2)
flod, lodge       depth of the tree from bands of distance (FLoD, Seo 2024, §4.3; LODGE, Kulhanek 2025)
filtergs          a table of ancestors and one pass over all nodes (Wang 2026, §3.2): the exact cut, as `select`
================  ==================================================================================================

Rules by distance decide each node alone, so where two bands meet a branch may be drawn twice, or not at all. A name with
``-per-node`` keeps that, and `violations` counts it; without it the first node of each path that is deep enough is drawn.

Deviations, all of them because the tree is not theirs. Octree-GS and FLoD train levels of their own, where here a level is a
depth of the tree, the finest the deepest. Octree-GS draws all coarser levels too (its anchors add up); in a tree whose nodes
replace their children the rule picks one. LODGE blends the two nearest chunks; here the nearest is drawn. H3DGS interpolates
between a node and its parent; here it switches. LoG drops roots that hid behind others: `log_serial` takes those that are left.

Cost: ``num_bytes`` beside the tree, made once; a view costs one pass over all rows, but for 3dgs, roots, depth and lodge, whose
rows are listed beforehand.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from splatree.errors import InputError
from splatree.kernels.cpu.frame import baselines as cpu
from splatree.kernels.cpu.frame import select as cpu_select
from splatree.lod.bands import Bands, centres_of, drawn_alone, flod_bands, octree_bands
from splatree.lod.select import count_nested, count_uncovered, for_levels
from splatree.lod.serial import child_table_of, select_serial
from splatree.scene.arguments import checked
from splatree.scene.cameras import Camera
from splatree.scene.frame import Selection
from splatree.scene.literals import check_literals
from splatree.scene.names import Profile
from splatree.scene.options import SelectOptions, ViewTest, check_pixels
from splatree.scene.scene import Scene
from splatree.scene.tree import GaussianTree
from splatree.scene.view import View, as_view
from splatree.shapes import Array, Int32

__all__ = ["Baseline", "BaselineName", "BaselineOptions", "Violations", "baseline", "violations"]

BaselineName = Literal[
    "3dgs",
    "roots",
    "depth",
    "h3dgs",
    "serial",
    "log-serial",
    "octree",
    "octree-per-node",
    "flod",
    "flod-per-node",
    "lodge",
    "filtergs",
    "filtergs-strict",
    "filtergs-release",
]
"""Named methods; see the head of this module."""


@dataclass(frozen=True)
class Request:
    """A view as a rule is asked about it."""

    view: View
    """Camera and options."""
    view_test: ViewTest
    """What is dropped as out of view."""
    threads: int
    """0: all there are."""

    @property
    def camera(self) -> Camera:
        """From where."""
        return self.view.camera


Choose = Callable[[Request], tuple[Array, int]]
"""Rows drawn, ascending, and how many were looked at."""


@dataclass(frozen=True)
class BaselineOptions:
    """Parameters of the published methods; each method uses its own.

    Example:
        >>> st.baseline("depth", scene, options=st.BaselineOptions(depth=1)).method
        'depth'
    """

    pixel_error: float = 3.0
    """For H3DGS, LoG and FilterGS: τ_R, px."""
    depth: int = 3
    """For the method `depth`: the only depth of the tree that is drawn."""
    fork: float = 2.0
    """For Octree-GS: factor of the distance from one level to the next."""
    bands: int = 5
    """For FLoD and LODGE: number of levels, as depths of the tree spread evenly from the deepest to the roots."""
    band_px: float = 1.0
    """For FLoD: γ, px; a level is drawn from the distance at which its median Gaussian has this standard deviation."""
    chunks: int = 8
    """For LODGE: number of places among the cameras for which rows are listed beforehand."""

    def __post_init__(self) -> None:
        check_literals(self)
        check_pixels("pixel_error", self.pixel_error)
        if self.depth < 0:
            raise InputError(f"depth: found {self.depth}, wanted 0 or more")
        if not self.fork > 1:
            raise InputError(f"fork: found {self.fork}, wanted more than 1")
        if self.bands < 1 or self.chunks < 1:
            raise InputError(f"bands, chunks: found {self.bands}, {self.chunks}, wanted at least 1")
        if not self.band_px > 0:
            raise InputError(f"band_px: found {self.band_px}, wanted more than 0 px")


@dataclass(frozen=True, eq=False)
class Baseline:
    """A published method of selection over one scene.

    `render` takes it in place of `SelectOptions`. `baseline` makes it.

    Example:
        >>> made = st.baseline("h3dgs", scene)
        >>> st.render(scene, camera, select=made).counters.num_selected > 0
        True
    """

    method: BaselineName
    """Name of the method."""
    scene: Scene
    """Scene that the rows are chosen from."""
    choose: Choose
    """Rule of the method: a view to its rows, and how many rows were looked at."""
    view_test: ViewTest
    """Test whether a node can be in the picture; `none` if the method leaves that to the renderer."""
    num_bytes: int
    """Memory of the data that the method needs beside the Gaussians and the tree's own ``subtree_end`` and ``depth``."""
    pixel_error: float
    """τ_R, px; 0 if the method has none."""
    profile: Profile | None
    """The radius that the method compares with τ_R; None: it compares something else, or nothing."""

    def __post_init__(self) -> None:
        check_literals(self)

    def __call__(self, view: View, *, threads: int = 0) -> Selection:
        """Choose the rows to draw."""
        rows, visited = self.choose(Request(view, self.view_test, threads))
        return Selection(rows, self.method, self.profile, self.pixel_error, visited)

    def cut(self, view: Camera | View) -> Int32[Array, "v"]:
        """The rows that stand for the whole scene, in view or not."""
        return self.choose(Request(as_view(view), "none", 0))[0]


@dataclass(frozen=True)
class Violations:
    """How far a choice is from standing for each leaf once."""

    duplicates: int
    """Rows drawn below another drawn row."""
    uncovered: int
    """Leaves that no drawn row stands for."""


def violations(tree: GaussianTree, rows: Array) -> Violations:
    """Count them; ``rows`` are those of `Baseline.cut`, seen and unseen."""
    return Violations(count_nested(tree, rows), count_uncovered(tree, rows))


@checked
def baseline(
    method: BaselineName, scene: Scene, cameras: Sequence[Camera] = (), options: BaselineOptions | None = None
) -> Baseline:
    """Prepare a published method of selection for a scene.

    What the method needs of the scene is computed once, here.

    Args:
        method: name of the method; docs/explanation/baselines.md lists them.
        scene: a scene with levels.
        cameras: views of the training; Octree-GS takes its distances from them, LODGE its places.
        options: parameters of the method; None: the defaults.

    Returns:
        The method, to be given to `render`, `trace` or `evaluate` as ``select``.

    Raises:
        InputError: the name is unknown, or the method needs cameras and there are none.

    Source:
        The papers named in docs/explanation/baselines.md; FilterGS 2026, Table 1.

    Example:
        >>> made = st.baseline("filtergs", scene)
        >>> bool((made.cut(camera) == st.baseline("serial", scene).cut(camera)).all())
        True
    """
    if method in ("octree", "octree-per-node", "lodge") and not cameras:
        raise InputError(f"method {method!r}: found no cameras, wanted those that the scene was trained on")
    options = options or BaselineOptions()
    tau = options.pixel_error
    tree = scene.tree

    def made(
        choose: Choose,
        num_bytes: int = 0,
        view_test: ViewTest = "footprint",
        pixel_error: float = 0.0,
        profile: Profile | None = None,
    ) -> Baseline:
        return Baseline(method, scene, choose, view_test, num_bytes, pixel_error, profile)

    if method in ("3dgs", "roots", "depth"):
        depth = {"3dgs": tree.num_levels, "roots": 0, "depth": options.depth}[method]
        listed = _at_depth(tree, depth)
        return made(_culled(scene, lambda asked: (listed, 0)), listed.nbytes, "none")
    if method == "h3dgs":
        rows, num_bytes = _h3dgs(scene, tau)
        return made(_culled(scene, rows), num_bytes, pixel_error=tau)
    if method in ("serial", "log-serial"):
        exact_cut = for_levels(SelectOptions(tau), scene)
        select = exact_cut if method == "serial" else SelectOptions(tau, rule="log-serial", profile="ref")
        return made(log_serial(scene, select), 12 * len(tree), pixel_error=tau, profile=select.profile)
    if method in ("filtergs", "filtergs-strict", "filtergs-release"):
        select = {
            "filtergs": for_levels(SelectOptions(tau), scene),
            "filtergs-strict": SelectOptions(tau, rule="paper-strict", profile="ref"),
            "filtergs-release": SelectOptions(tau, rule="release", profile="ref"),
        }[method]
        choose, num_bytes = _filtergs(scene, select)
        return made(choose, num_bytes, "centre" if select.rule == "release" else "footprint", tau, select.profile)
    if method == "lodge":
        rows, num_bytes = _lodge(scene, cameras, options)
        return made(_culled(scene, rows), num_bytes, "none")
    bands = (
        octree_bands(scene, cameras, options.fork)
        if method.startswith("octree")
        else flod_bands(scene, options.bands, options.band_px)
    )
    return made(_culled(scene, _by_depth(scene, bands, alone=method.endswith("per-node"))), bands.num_bytes)


def log_serial(scene: Scene, select: SelectOptions, roots: Array | None = None) -> Choose:
    """The traversal level by level; ``roots`` are those not hidden by others, None: all."""
    table = child_table_of(scene.tree)

    def choose(asked: Request) -> tuple[Array, int]:
        return select_serial(
            scene.gaussians,
            scene.tree,
            None,
            asked.view,
            replace(select, view_test=asked.view_test),
            table=table,
            roots=roots,
            threads=asked.threads,
        )

    return choose


def _culled(scene: Scene, rows_of: Choose) -> Choose:
    """A rule that does not look at the view, followed by the view test."""

    def choose(asked: Request) -> tuple[Array, int]:
        rows, visited = rows_of(asked)
        if asked.view_test == "none":
            return rows, visited
        options = SelectOptions(view_test=asked.view_test)
        seen = cpu_select.visible(scene.gaussians, scene.tree, rows, asked.view, options, threads=asked.threads)
        return rows[seen], visited

    return choose


def _at_depth(tree: GaussianTree, depth: int) -> Int32[Array, "v"]:
    return np.flatnonzero((tree.depth == depth) | ((tree.depth < depth) & tree.is_leaf)).astype(np.int32)


def _h3dgs(scene: Scene, pixel_error: float) -> tuple[Choose, int]:
    """Boxes are nested, so the size never grows towards the leaves: its test of the parent picks the first small one."""
    lower, upper = cpu.nested_boxes(scene.gaussians, scene.tree)

    def rows_of(asked: Request) -> tuple[Array, int]:
        # 2 (τ + ½) tan(fov_x / 2) / (W / 2), as its script for rendering has it.
        limit = 2 * (pixel_error + 0.5) / asked.camera.K[0, 0]
        small = cpu.small_boxes(lower, upper, asked.camera.position, limit, threads=asked.threads)
        return cpu.first_stops(scene.tree, small, 1), len(scene)

    return rows_of, lower.nbytes + upper.nbytes


def _filtergs(scene: Scene, select: SelectOptions) -> tuple[Choose, int]:
    table = cpu_select.ancestor_table(scene.tree)

    def choose(asked: Request) -> tuple[Array, int]:
        options = replace(select, view_test=asked.view_test)
        rows, visited = cpu_select.select_by_ancestors(
            scene.gaussians, scene.tree, table, asked.view, options, threads=asked.threads
        )
        if select.rule == "release" and asked.view_test != "none":
            largest = replace(options, pixel_error=RELEASE_LARGEST_PX)
            rows = rows[cpu_select.small(scene.gaussians, scene.tree, rows, asked.view, largest, threads=asked.threads)]
        return rows, visited

    return choose, table.nbytes


RELEASE_LARGEST_PX = 700.0
"""The code of FilterGS drops whatever is larger, leaves too."""


def _by_depth(scene: Scene, bands: Bands, *, alone: bool) -> Choose:
    def rows_of(asked: Request) -> tuple[Array, int]:
        flags = bands.flags(scene, asked.camera, asked.camera.position, asked.threads)
        if alone:
            return np.flatnonzero(drawn_alone(scene.tree, flags)).astype(np.int32), len(scene)
        return cpu.first_stops(scene.tree, flags, 1), len(scene)

    return rows_of


def _lodge(scene: Scene, cameras: Sequence[Camera], options: BaselineOptions) -> tuple[Choose, int]:
    """Rows of FLoD's bands around places among the cameras, listed beforehand; a view takes the list of the nearest place."""
    bands = flod_bands(scene, options.bands, options.band_px)
    places = centres_of(np.array([camera.position for camera in cameras]), options.chunks)
    listed = [
        np.flatnonzero(drawn_alone(scene.tree, bands.flags(scene, cameras[0], place, 0))).astype(np.int32)
        for place in places
    ]

    def rows_of(asked: Request) -> tuple[Array, int]:
        return listed[int(np.argmin(np.linalg.norm(places - asked.camera.position, axis=1)))], 0

    return rows_of, sum(rows.nbytes for rows in listed)
