"""Step 0 of a frame: leave out clusters that cannot be seen, before anything of their Gaussians is read (Jo 2024, §3).

A sphere with view coordinates (X, Y, Z) and radius R lies beyond the right border u of the image, with w = u − cx, if

    f X − w Z > √(f² + w²) R                                             (a half-space through the eye)
    f X − w Z > f R                                                      (Jo 2024, Eq. 3: r = R f / Z)

and likewise for the other borders. Eq. 3 misses the factor sec φ of the border's angle, so it leaves out spheres that reach into
the image. A box with half sizes h along the world's axes takes Σ |n_a| h_a in the place of √(f² + w²) R, n = f x − w z in the
world; it knows the shapes of its Gaussians, a sphere only their largest axes. The rules:

``exact``        no row that our projection would draw is left out, by any tile rule; the picture keeps every bit. By spheres,
                 and by boxes too where splats end as ellipses at τ ≥ 1/255
``exact-inria``  the same for the rasteriser of Kerbl 2023: squares of 3σ, rounded up, over tiles
``exact-gsplat`` the same for gsplat: boxes of √(2 ln 255 o) σ, at most 3.33 σ, rounded up
``planes``       the half-spaces with the radii of Eq. 2, without the rasteriser's margins
``paper``        Eq. 3 read literally; spheres whose centre is behind the eye are left out
``paper-guard``  the same, but spheres that reach the plane of the eye are kept
``paper-distance``  Eq. 3 with radii that hold the means only: the ablation "only distance" of Table I

docs/explanation/clusters.md has the proof. Cost: five dot products a sphere, ten a box, 5 ns each; rows of Gaussians are never
touched, and the result is a list of runs of rows.
"""

import math
from typing import NamedTuple, get_args

import numpy as np

from splatree.constants import (
    ALPHA_THRESHOLD,
    DILATION_MIN_PX2,
    EIGENVALUE_FLOOR_PX4,
    SHRINK_PAD_PX,
    SIGMAS,
    TILE_PX,
)
from splatree.errors import InputError
from splatree.kernels.cpu.frame import cull as kernel
from splatree.maths.slopes import held_slopes
from splatree.scene.arguments import checked
from splatree.scene.cameras import Camera
from splatree.scene.clusters import ClusterIndex, Culling, Sides
from splatree.scene.options import Cull
from splatree.scene.view import View, as_view
from splatree.shapes import Array, Float32, Float64, Int32

__all__ = ["cull", "sides_of"]

RADIUS_SCALE = 1.0001
"""Factor on radii in the exact rules: what float32 loses of standard deviations and of their projection, with much to spare."""
POSITION_SLACK = 2e-6
"""Radius added for each unit of distance from the eye: 16 times the rounding of float32 (six roundings, each 6e-8)."""
REACH_SCALE = 1.002
"""Factor on projected standard deviations: the selection's test widens footprints by 0.1 %, and must agree."""
BORDER_PX = 0.02
"""Likewise its 0.01 px, and the rounding of pixel coordinates."""
BOX_SLACK = 2e-5
"""Reach added for each unit of half size, of that of a unit of radius: what float32 loses of a long thin Gaussian, whose extent
across its axis is a difference of larger numbers. 30 roundings of its length, each 6e-8, over √3, and ten times as much again."""
STRETCH = 1.0002
"""Rotations may be off by 1e-4 in each entry of R Rᵀ (`Camera`), so they lengthen vectors by 1.6e-4 at most."""

Axes = tuple[tuple[float, float, int], tuple[float, float, int]]
"""Focal length and principal point, px, and number of pixels, of the image's x and y."""


class Margins(NamedTuple):
    """What a rasteriser adds around Gaussians along one axis of the image, px; docs/explanation/clusters.md."""

    lower: float
    """Least coordinate of the image that counts, px."""
    upper: float
    """Largest coordinate that counts, px."""
    extra: float
    """δ: px that a splat reaches beyond the projection of its standard deviations."""
    gain: float
    """f g: px that a unit of radius at unit depth covers at most, with the slopes that the Jacobian can have."""


@checked
def cull(clusters: ClusterIndex, view: Camera | View, rule: Cull = "exact", *, threads: int = 0) -> Culling:
    """Decide which clusters may be in a picture.

    Args:
        clusters: spheres and boxes around runs of rows.
        view: a camera, for drawing with the usual options; or a view, for whose dilation, τ and tile rule `exact` holds.
        rule: `exact` leaves out what provably changes no bit of the picture; the other rules are there to compare with.
        threads: threads to use; 0: all.

    Returns:
        The clusters that are kept, and their rows as runs.

    Raises:
        InputError: there is no rule of that name.

    Source:
        Jo 2024, §3, Eq. 2 and 3, for the rules that begin with `paper`; docs/explanation/clusters.md proves `exact`.

    Example:
        >>> st.cull(scene.clusters, camera).num_rows <= len(scene)
        True
    """
    view = as_view(view)
    if rule == "none":
        kept = np.ones(len(clusters), bool)
    else:
        sides = sides_of(view, rule)
        radii, near_radii = _radii(clusters, view, rule)
        kept = kernel.cull(clusters.centers, radii, near_radii, sides, threads=threads)
        if sides.box_reaches is not None:
            kept &= kernel.cull_boxes(clusters.box_low, clusters.box_high, sides, threads=threads)
    return Culling(kept, runs_of(clusters.start, kept), rule)


def runs_of(start: Int32[Array, "c+1"], kept: Array) -> Int32[Array, "r 2"]:
    """Runs of rows of the kept clusters; neighbours are one run."""
    padded = np.zeros(len(kept) + 2, bool)
    padded[1:-1] = kept
    return start[np.flatnonzero(padded[1:] != padded[:-1])].reshape(-1, 2)


def sides_of(view: View, rule: Cull) -> Sides:
    """The planes of a rule."""
    camera, dilation_px2, threshold = view.camera, view.dilation_px2, view.threshold
    (fx, _, cx), (_, fy, cy), _ = camera.K.tolist()
    axes = ((fx, cx, camera.width), (fy, cy, camera.height))
    if rule in ("paper", "paper-guard", "paper-distance"):
        return _sides_of_paper(camera, axes, guard=rule == "paper-guard")
    if rule == "planes":
        return _sides(camera, axes, [Margins(0, size, 0, 0) for _, _, size in axes])
    k = _reach_of_opaque(min(threshold, ALPHA_THRESHOLD))
    if rule == "exact" and view.is_square:
        margins = [_margins_of_square(axes, size, dilation_px2, SHRINK_PAD_PX) for _, _, size in axes]
    elif rule == "exact":
        margins = [_margins_of_box(*axis, k, dilation_px2) for axis in axes]
    elif rule == "exact-gsplat":
        margins = [_margins_of_gsplat(*axis, k, dilation_px2) for axis in axes]
    elif rule == "exact-inria":
        margins = [_margins_of_square(axes, size, dilation_px2) for _, _, size in axes]
    else:
        raise InputError(f"cull: found rule {rule!r}, wanted one of {', '.join(get_args(Cull))}")
    if rule == "exact":
        has_boxes = not view.is_square and threshold >= ALPHA_THRESHOLD
        return _sides(camera, axes, margins, scale=RADIUS_SCALE, slack=POSITION_SLACK, has_boxes=has_boxes)
    # These transform by R x + t in float32, so they lose digits of x and of t, not of their difference as ours does.
    lost = 2 * POSITION_SLACK * float(np.abs(camera.position).sum())
    return _sides(camera, axes, margins, scale=RADIUS_SCALE, slack=POSITION_SLACK, margin=lost)


def _radii(clusters: ClusterIndex, view: View, rule: Cull) -> tuple[Float32[Array, "c"], Float32[Array, "c"]]:
    """Radii for the four borders, and for the near plane, which drops Gaussians by their centres."""
    if rule == "paper-distance":
        return clusters.mean_radii, clusters.mean_radii
    if not (rule == "exact-gsplat" or (rule == "exact" and not view.is_square)):
        return clusters.radii, clusters.mean_radii
    if view.threshold >= ALPHA_THRESHOLD:
        return clusters.footprint_radii, clusters.mean_radii
    # d + k σ ≤ (k / 3) (d + 3 σ) where k ≥ 3: the radii of Eq. 2 bound the footprints of a smaller τ, too.
    return clusters.radii * np.float32(_reach_of_opaque(view.threshold) / SIGMAS), clusters.mean_radii


def _margins_of_box(focal: float, centre: float, size: int, k: float, dilation_px2: float) -> Margins:
    """Our projection: the box k √(Σ'ii) must hold a pixel centre, ½ to size − ½."""
    extra = REACH_SCALE * k * math.sqrt(max(dilation_px2, DILATION_MIN_PX2)) + BORDER_PX
    return Margins(0.5, size - 0.5, extra, focal * math.hypot(1, _slope(focal, centre, size)))


def _margins_of_gsplat(focal: float, centre: float, size: int, k: float, dilation_px2: float) -> Margins:
    """gsplat: the box ⌈k √(Σ'ii)⌉ with k = min(3.33, √(2 ln 255 o)) must meet the image."""
    extra = k * math.sqrt(dilation_px2) + 1 + BORDER_PX
    return Margins(0, size, extra, focal * math.hypot(1, _slope(focal, centre, size)))


def _margins_of_square(axes: Axes, size: int, dilation_px2: float, pad_px: float = 0.0) -> Margins:
    """Kerbl 2023: a square of ⌈3 √λ⌉, λ = m + √max(0.1, m² − det), that meets a tile; the image is padded to whole tiles."""
    sigma_of_dot = math.sqrt(max(dilation_px2, DILATION_MIN_PX2) + math.sqrt(EIGENVALUE_FLOOR_PX4))
    extra = SIGMAS * sigma_of_dot + 1 + 0.5 + pad_px  # ⌈·⌉, and pixel centres at whole numbers
    # The Jacobian's slopes end at 1.3 half fields of view, as if the principal point were in the middle.
    slopes = (max(_slope(focal, pixels / 2, pixels), _slope(focal, centre, pixels)) for focal, centre, pixels in axes)
    widest = max(focal for focal, _, _ in axes)
    return Margins(0, TILE_PX * math.ceil(size / TILE_PX), extra, widest * math.hypot(1, *slopes))


def _slope(focal: float, centre: float, size: int) -> float:
    """Largest |x/z| in the Jacobian."""
    least, largest = held_slopes(focal, centre, size)
    return max(-least, largest)


def _sides(
    camera: Camera,
    axes: Axes,
    margins: list[Margins],
    *,
    scale: float = 1.0,
    slack: float = 0.0,
    margin: float = 0.0,
    has_boxes: bool = False,
) -> Sides:
    """f X − (w + δ) Z > R max(√(f² + (w + δ)²), f g) for each border; and Z + R ≤ near."""
    x_and_y, depth = camera.camera_from_world[:2], camera.camera_from_world[2]
    planes, reaches = np.empty((5, 4)), np.ones(5)
    for i, ((focal, centre, _), around) in enumerate(zip(axes, margins, strict=True)):
        for side, border in ((2 * i, around.upper - centre), (2 * i + 1, around.lower - centre)):
            sign = 1 if side % 2 == 0 else -1
            offset = sign * border + around.extra
            planes[side] = sign * focal * x_and_y[i] - offset * depth
            reaches[side] = max(STRETCH * math.hypot(focal, offset), REACH_SCALE * around.gain)
    planes[4] = -depth
    planes[4, 3] += camera.near
    reaches[4] = STRETCH
    box_reaches = _box_reaches(camera, axes, planes, reaches) if has_boxes else None
    return Sides(planes, reaches, camera.position, scale, slack, margin, box_reaches=box_reaches)


def _box_reaches(camera: Camera, axes: Axes, planes: Array, reaches: Array) -> Float64[Array, "5 3"]:
    """max(|n_a|, |n'_a|) along each axis a of the world: n the plane, n' the plane at the last slope of the Jacobian."""
    x_and_y, depth = camera.camera_from_world[:2, :3], camera.camera_from_world[2, :3]
    focal, slope = np.array(
        [
            (sign * focal, sign * slope)
            for focal, centre, size in axes
            for sign, slope in zip((1, -1), held_slopes(focal, centre, size)[::-1], strict=True)
        ]
    ).T[:, :, None]  # [4 1] each
    last = focal * x_and_y[[0, 0, 1, 1]] - np.abs(focal) * slope * depth  # [4 3]
    normals = np.abs(planes[:, :3])
    np.maximum(normals[:4], np.abs(last), out=normals[:4])
    return np.asarray(REACH_SCALE * normals + BOX_SLACK * reaches[:, None])


def _sides_of_paper(camera: Camera, axes: Axes, *, guard: bool) -> Sides:
    """Eq. 3 times Z: the square around the circle of radius r = R f / Z misses the image, or Z ≤ 0."""
    x_and_y, depth = camera.camera_from_world[:2], camera.camera_from_world[2]
    planes, reaches = np.empty((5, 4)), np.zeros(5)
    for i, (focal, centre, size) in enumerate(axes):
        planes[2 * i] = focal * x_and_y[i] - (size - centre) * depth
        planes[2 * i + 1] = -focal * x_and_y[i] - centre * depth
        reaches[2 * i : 2 * i + 2] = focal
    planes[4] = -depth
    planes[4, 3] = np.nextafter(planes[4, 3], np.inf)  # so that Z = 0 is beyond it
    return Sides(planes, reaches, camera.position, guard=guard)


def _reach_of_opaque(threshold: float) -> float:
    """Standard deviations at which an opacity of 1 falls to the threshold."""
    return math.sqrt(-2 * math.log(threshold))
