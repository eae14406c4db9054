"""The nodes of the tree that stand for a scene in one view (FilterGS §3.2), by definition.

With a radius R(v) ≥ 0 in px, a node is *small* if R(v) ≤ τ_R, and *stops* if it is small and has children. The cut is

    C = { v : v is a leaf or small, and no proper ancestor of v stops },

so each leaf has exactly one member of C among itself and its ancestors. The part of C that is in view is drawn; the cut itself
does not depend on what is in view. In preorder the ranges [u, subtree_end[u]) of the stopping nodes are nested or disjoint,
hence

    v is shadowed  ⇔  max { subtree_end[u] : u < v, u stops } > v:

one exclusive prefix maximum, whatever the depth and whether or not radii shrink towards the leaves. `cut_by_walk` is the
same set found by walking down.

Radius, with Σ' the covariance of the splat on the image (`project`), h the dilation, m = (A + C) / 2:

    exact   A = Σ'00 + h, C = Σ'11 + h:           R = 3 √λ, λ = m + √(m² − det)
    3dgs    the same:                             λ = m + √max(0.1, m² − det)           (Kerbl 2023, not rounded)
    ref     A = max(Σ'00, 0.3), C likewise:       λ as 3dgs                             (code of FilterGS)
    sphere  R = f e / (|v − eye| − e), e = tree.extents: the same for all view directions; never smaller than a child's
            if the balls of extents are nested
    pixel   R = f e / |v − eye|: τ_R = 3 px where a pixel is e / 3 wide

Where the view depth is not beyond the near plane, R = ∞ (refine); `sphere` has no such region but the ball itself, `pixel` none.
m² − det = ((A − C) / 2)² + B² is a sum of squares, so det ≤ 0 (for which FilterGS's code has R = 0) cannot arise.
"""

from dataclasses import dataclass

import numpy as np

from splatree.constants import CENTRE_PAD, DILATION_PX2, EIGENVALUE_FLOOR_PX4, SIGMAS
from splatree.maths.covariance import axes_from_gaussians
from splatree.maths.slopes import held_slopes
from splatree.scene.cameras import Camera
from splatree.scene.frame import CutRange
from splatree.scene.gaussians import Gaussians
from splatree.scene.names import EXTENT_PROFILES, Profile
from splatree.scene.options import SelectOptions, ViewTest
from splatree.scene.tree import BlockIndex, GaussianTree
from splatree.scene.view import View
from splatree.shapes import Array, Bool, Float64, Int32

LARGEST_SIZE = 3.4e38
"""Size of a node that no finite limit makes small."""

__all__ = [
    "Footprints",
    "centred",
    "cut_by_walk",
    "cut_rows",
    "in_runs",
    "project",
    "radii",
    "select",
    "select_range",
    "shadowed",
    "visible",
]


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
    """Rows drawn, ascending, by the rules `cut`, `paper-strict` or `release`, and how many were looked at: all.

    With ``runs``, ascending first rows and ends, only rows in one of them are drawn. ``blocks``, ``threads`` and the options
    ``budget`` and ``max_radius`` are not used.

    `cut`           the definition above.
    `paper-strict`  only visible nodes take part: those out of view neither stop nor are drawn.
    `release`       the code of FilterGS: each small inner node is drawn, also below another; only leaves look at their
                    ancestors, and visible ones alone shadow.
    """
    small = (
        radii(gaussians, tree.extents, view.camera, options.resolved_profile, view.dilation_px2) <= options.pixel_error
    )
    seen = visible(gaussians, view.camera, options.view_test, view.dilation_px2, view.least_threshold)
    leaf, end = tree.is_leaf, tree.subtree_end
    if options.rule == "cut":
        drawn = (leaf | small) & ~shadowed(~leaf & small, end) & seen
    elif options.rule == "paper-strict":
        drawn = (leaf | small) & ~shadowed(~leaf & small & seen, end) & seen
    elif options.rule == "release":
        drawn = np.where(leaf, ~shadowed(~leaf & small & seen, end), small) & seen
    else:
        raise ValueError(f"rule {options.rule!r} is a traversal: see lod/serial.py")
    if runs is not None:
        drawn &= in_runs(np.arange(len(tree), dtype=np.int32), runs)
    return np.flatnonzero(drawn).astype(np.int32), len(tree)


def select_range(
    gaussians: Gaussians,
    tree: GaussianTree,
    blocks: BlockIndex | None,
    view: View,
    options: SelectOptions,
    *,
    coarsest: float,
    every: int = 1,
    runs: Int32[Array, "r 2"] | None = None,
    threads: int = 0,
) -> CutRange:
    """The cuts of all τ_R from that of the options to ``coarsest``, px and finite, by the rule `cut`: with sizes s and limits L,

        v is drawn by L  ⇔  s(v) ≤ L < min { s(u) : u a proper ancestor of v },  a leaf also if s(v) > L.

    All rows are looked at, whatever ``every`` says; ``blocks`` and ``threads`` are not used.
    """
    profile = options.resolved_profile
    sizes = radii(gaussians, tree.extents, view.camera, profile, view.dilation_px2)
    finest, largest = options.pixel_error, coarsest
    if profile not in EXTENT_PROFILES:
        sizes, finest, largest = (sizes / SIGMAS) ** 2, (finest / SIGMAS) ** 2, (largest / SIGMAS) ** 2
    leave = np.full(len(tree), np.inf)
    for row in np.flatnonzero(~tree.is_leaf):
        below = slice(row + 1, tree.subtree_end[row])
        leave[below] = np.minimum(leave[below], sizes[row])
    enter = np.where(tree.is_leaf | (sizes <= finest), 0, sizes)
    drawn = (enter <= largest) & (enter < leave) & (finest < leave)
    drawn &= visible(gaussians, view.camera, options.view_test, view.dilation_px2, view.least_threshold)
    if runs is not None:
        drawn &= in_runs(np.arange(len(tree), dtype=np.int32), runs)
    rows = np.flatnonzero(drawn).astype(np.int32)
    beyond = np.where(leave > largest, LARGEST_SIZE, leave)
    return CutRange(rows, enter[rows].astype(np.float32), beyond[rows].astype(np.float32), len(tree))


def in_runs(rows: Int32[Array, "v"], runs: Int32[Array, "r 2"]) -> Bool[Array, "v"]:
    """Whether each row is in one of the runs: an odd number of their bounds is at or before it."""
    return np.asarray(np.searchsorted(runs.ravel(), rows, side="right") % 2 == 1)


def cut_rows(tree: GaussianTree, radii: Array, pixel_error: float) -> Int32[Array, "v"]:
    """Rows of the cut, seen or not, by one prefix maximum."""
    small, leaf = radii <= pixel_error, tree.is_leaf
    return np.flatnonzero((leaf | small) & ~shadowed(small & ~leaf, tree.subtree_end)).astype(np.int32)


def cut_by_walk(tree: GaussianTree, radii: Array, pixel_error: float) -> Int32[Array, "v"]:
    """Rows of the cut, seen or not, by walking down: the first node of each path that is a leaf or small."""
    rows = []
    row = 0
    while row < len(tree):
        end = int(tree.subtree_end[row])
        if end == row + 1 or radii[row] <= pixel_error:
            rows.append(row)
            row = end
        else:
            row += 1
    return np.array(rows, np.int32)


def shadowed(stops: Array, subtree_end: Array) -> Bool[Array, "n"]:
    """Whether a proper ancestor of each row stops."""
    reach = np.maximum.accumulate(np.where(stops, subtree_end, 0))
    before = np.concatenate([[0], reach])[: len(reach)]  # of the rows before each row
    return np.asarray(before > np.arange(len(reach)))


@dataclass(frozen=True, eq=False)
class Footprints:
    """Gaussians on the image, before dilation; without meaning where the depth is not beyond the near plane."""

    centres_px: Float64[Array, "n 2"]
    """Projected means, px."""
    depths: Float64[Array, "n"]
    """View depths of the means, world units."""
    covariances: Float64[Array, "n 2 2"]
    """Σ', px²."""


def project(gaussians: Gaussians, camera: Camera) -> Footprints:
    """Σ' = (J W R S)(J W R S)ᵀ, J the projection's derivative in a direction held within the image and 0.3 half fields around."""
    rotation, translation = camera.camera_from_world[:3, :3], camera.camera_from_world[:3, 3]
    focal = np.array([camera.K[0, 0], camera.K[1, 1]])
    centre = np.array([camera.K[0, 2], camera.K[1, 2]])
    view = gaussians.means.astype(np.float64) @ rotation.T + translation
    depths = view[:, 2]
    safe = np.where(depths > camera.near, depths, 1.0)
    slopes = view[:, :2] / safe[:, None]
    least, largest = np.transpose(
        [held_slopes(*axis) for axis in zip(focal, centre, (camera.width, camera.height), strict=True)]
    )
    clamped = np.clip(slopes, least, largest)
    J = np.zeros((len(view), 2, 3))
    J[:, 0, 0] = J[:, 1, 1] = 1.0
    J[:, :, 2] = -clamped
    J *= focal[None, :, None] / safe[:, None, None]
    axes = J @ rotation @ axes_from_gaussians(gaussians.quats, gaussians.log_scales)  # [n 2 3]
    return Footprints(slopes * focal + centre, depths, axes @ np.swapaxes(axes, 1, 2))


def radii(
    gaussians: Gaussians, extents: Array, camera: Camera, profile: Profile, dilation_px2: float
) -> Float64[Array, "n"]:
    """R of each row, px; ``extents`` is that of the tree."""
    if profile in EXTENT_PROFILES:
        extents = extents.astype(np.float64)
        distances = np.linalg.norm(gaussians.means - camera.position, axis=1) - (profile == "sphere") * extents
        outside = distances > 0
        focal = max(camera.K[0, 0], camera.K[1, 1])
        return np.asarray(np.where(outside, focal * extents / np.where(outside, distances, 1.0), np.inf))
    splats = project(gaussians, camera)
    A, B, C = splats.covariances[:, 0, 0], splats.covariances[:, 0, 1], splats.covariances[:, 1, 1]
    if profile == "ref":
        A, C = np.maximum(A, DILATION_PX2), np.maximum(C, DILATION_PX2)
    else:
        A, C = A + dilation_px2, C + dilation_px2
    floor = 0.0 if profile == "exact" else EIGENVALUE_FLOOR_PX4
    eigenvalues = (A + C) / 2 + np.sqrt(np.maximum(floor, ((A - C) / 2) ** 2 + B**2))
    return np.where(splats.depths > camera.near, SIGMAS * np.sqrt(eigenvalues), np.inf)


def visible(
    gaussians: Gaussians, camera: Camera, view_test: ViewTest, dilation_px2: float, threshold: float
) -> Bool[Array, "n"]:
    """Whether each row passes the named test. What antialiasing takes off the opacity is not counted.

    `footprint`  beyond the near plane, and the box outside of which its opacity is below ``threshold`` holds the row and the
                 column of a pixel centre: half width √(2 ln(α / threshold) (Σ'00 + h)).
    `centre`     beyond the near plane, and the centre is in the image enlarged by a tenth (code of FilterGS).
    `none`       always.
    """
    if view_test == "none":
        return np.ones(len(gaussians), bool)
    splats = project(gaussians, camera)
    if view_test == "centre":
        return centred(splats, camera, CENTRE_PAD)
    # ln(α / threshold) with ln α = −ln(1 + e^−logit)
    fall = -np.logaddexp(0.0, -gaussians.logit_opacities.astype(np.float64)) - np.log(threshold)
    variances = np.diagonal(splats.covariances, axis1=1, axis2=2) + dilation_px2
    reach = np.sqrt(2 * np.maximum(fall, 0)[:, None] * variances)  # [n 2]
    return np.asarray(_meets_image(splats, camera, reach - 0.5) & (fall >= 0))


def centred(splats: Footprints, camera: Camera, pad: float) -> Bool[Array, "n"]:
    """Whether each centre is beyond the near plane and in the image enlarged by ``pad`` half sizes on each side."""
    return _meets_image(splats, camera, pad * np.array([camera.width, camera.height]) / 2)


def _meets_image(splats: Footprints, camera: Camera, reach: Array) -> Bool[Array, "n"]:
    size = np.array([camera.width, camera.height])
    inside = ((splats.centres_px + reach >= 0) & (splats.centres_px - reach <= size)).all(axis=1)
    return np.asarray(inside & (splats.depths > camera.near))
