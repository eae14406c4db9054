"""What the selection asks, as the compiled kernels take it: of each row, and of whole blocks of rows."""

import math
from typing import NamedTuple

import numpy as np

from splatree.constants import CENTRE_PAD, DILATION_PX2, EIGENVALUE_FLOOR_PX4, SIGMAS
from splatree.kernels.cpu.frame.view import PackedView, pack_view
from splatree.scene.names import EXTENT_PROFILES, Profile
from splatree.scene.options import SelectOptions
from splatree.scene.view import View
from splatree.shapes import Array, Float64

__all__ = ["PackedQuestion", "PackedRule", "PackedSides", "limit_of", "pack_question", "pack_sides", "pixel_error_of"]

CULL_BELOW_PX = 1e6
"""Largest τ_R for which blocks are tested against the image: drawn inner nodes reach out of their block by as much."""
BORDER_PX = 1.0
"""Blocks are dropped, or taken for well inside, with this distance to spare (half of it inwards), so that they agree with
what float32 says of their rows."""


class PackedRule(NamedTuple):
    """The numbers of the struct SelectRule in shared/select.h, by their names there."""

    limit: float
    """Largest size of a small node: `limit_of`."""
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
    """Whether a node's size is its extent."""
    ball: float
    """Share of its extent by which a node is nearer than its mean."""


def _pack_rule(view: View, options: SelectOptions) -> PackedRule:
    """The numbers that the kernels take of the options."""
    camera, dilation_px2, threshold = view.camera, view.dilation_px2, view.least_threshold
    focal = camera.K[0, 0], camera.K[1, 1]
    limit = limit_of(options.pixel_error, options.resolved_profile)
    added = (0.0, DILATION_PX2) if options.resolved_profile == "ref" else (dilation_px2, 0.0)
    floor = 0.0 if options.resolved_profile == "exact" else EIGENVALUE_FLOOR_PX4
    # Opacities are compared as logits; the slack of 1e-3 covers the rounding of the sigmoid in the projection.
    logit_min = np.log(threshold / (1 - threshold)) - 1e-3
    pads = CENTRE_PAD * camera.width / 2, CENTRE_PAD * camera.height / 2
    sizes = limit, *added, floor, options.pixel_error, max(focal), min(focal), _reach_of_opaque(threshold)
    profile = options.resolved_profile
    return PackedRule(*sizes, logit_min, *pads, profile in EXTENT_PROFILES, float(profile == "sphere"))


def limit_of(pixel_error: float, profile: Profile) -> float:
    """What the kernels compare sizes with: (τ_R / 3)², px²; τ_R, px, where the size is that of the extent."""
    return float(pixel_error if profile in EXTENT_PROFILES else (pixel_error / SIGMAS) ** 2)


def pixel_error_of(limit: float, profile: Profile) -> float:
    """The τ_R, px, of a float32 that sizes are compared with: its limit is this float32 again."""
    return limit if profile in EXTENT_PROFILES else SIGMAS * math.sqrt(limit)


def _reach_of_opaque(threshold: float) -> float:
    """Standard deviations at which an opacity of 1 falls to the threshold."""
    return float(np.sqrt(-2 * np.log(threshold)))


class PackedQuestion(NamedTuple):
    """What the selection asks of each row: whether it is small, and whether it can be seen."""

    view: PackedView
    """Where the rows are seen from."""
    threshold: float
    """Opacity at which rows count as unseen."""
    rule: PackedRule
    """When a row is small."""
    view_test: str
    """When a row can be seen: a `SelectOptions.view_test`."""


def pack_question(view: View, options: SelectOptions) -> PackedQuestion:
    """The question that the options ask of each row in a view."""
    return PackedQuestion(pack_view(view), view.least_threshold, _pack_rule(view, options), options.view_test)


class PackedSides(NamedTuple):
    """What the selection asks of a whole block: on which sides of which planes it lies."""

    is_culled: bool
    """Whether blocks are tested against the image."""
    planes: Float64[Array, "11 4"]
    """The struct ViewPlanes of shared/select.h as rows (n, d) of n·p + d."""
    reaches: Float64[Array, "5"]
    """How far a unit of σ reaches over each side."""


def pack_sides(view: View, options: SelectOptions, packed: PackedView) -> PackedSides:
    """The planes of a view; ``packed`` is what `pack_view` made of it.

    A splat at view coordinates (x, z) with standard deviation s reaches at most k (s (f/z) √(1 + u²) + √h) px from its
    centre f x/z + c, u the largest slope that the Jacobian has; so it is right of the border b if

        f x − (b − c + k √h) z > k f √(1 + u²) s.

    An inner node that is drawn is small, so it reaches at most k √((τ_R / 3)² + h) whatever its s; s is that of the leaves.
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
    is_culled = options.view_test != "none" and options.pixel_error < CULL_BELOW_PX
    return PackedSides(bool(is_culled), np.array(planes, np.float64), np.array([*reach, 0.0]))


def _plane(a: float, x: list[float], b: float, y: list[float]) -> list[float]:
    """a x − b y."""
    return [a * one - b * other for one, other in zip(x, y, strict=True)]
