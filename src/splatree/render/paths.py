"""Camera paths for scenes that come without cameras, and through those that a scene has.

The centre and the size of a trained scene have to be robust: far outliers and nearly transparent floaters reach hundreds of
times beyond what the pictures show. Here the centre is the median of the leaves' centres along each axis, weighted by
opacity, and the radius holds 90 % of the opacity around it. Cost: a sort of at most 200,000 leaves.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from splatree.constants import NEAR
from splatree.errors import InputError
from splatree.maths.rotations import matrices_from_quats, quat_from_matrix
from splatree.render.framing.frame import Framing
from splatree.render.framing.survey import survey_of
from splatree.render.framing.upright import guess_up
from splatree.scene.arguments import checked
from splatree.scene.cameras import SIDE_MAX_PX, Camera, Cameras
from splatree.scene.gaussians import Gaussians
from splatree.scene.given import given
from splatree.scene.literals import check_literals
from splatree.scene.scene import Scene, check_is_scene
from splatree.shapes import Array, Float64

_ROWS_AT_ONCE: Final = 1 << 16

SAMPLE: Final = 200_000
"""Leaves looked at, evenly spread over the rows: the medians of larger samples differ by less than 1 % of the radius."""

SHARE: Final = 0.9
"""Share of the opacity within the radius; the rest of a drone capture is its ragged far rim."""

RIM_SHARE: Final = 0.99
"""Share of the opacity that an orbit shows: the head of a figure belongs in its picture …"""

RIM_MAX: Final = 1.25
"""… as far as this many radii: farther out is a rim that would make the scene small."""

NEAR_SHARE: Final = 0.01
"""The near plane is at most this share of the distance to the target: a scene in kilometres must not vanish in front of it."""


FARTHEST: Final = 1e6
"""Radii from which a scene is less than a pixel."""

VIEWS_MAX: Final = 1_000_000
"""Nine hours of a video; more is a mistake."""

ELEVATION_DEG: Final = 30.0
"""Height of the eye above the horizon where none is asked for."""

FOV_Y_DEG: Final = 50.0
"""Vertical field of view where none is asked for, degrees."""


@dataclass(frozen=True)
class PathOptions:
    """Views that are made for a scene.

    Example:
        >>> len(st.orbit(scene, st.PathOptions(views=3, width=64, height=36)))
        3
    """

    views: int = 60
    """Number of views."""
    up: tuple[float, float, float] | None = None
    """Direction x y z that is up in the world; None: guessed from the scene and its file."""
    elevation_deg: float | None = None
    """Height of the camera above the horizon, degrees, as seen from the target, -90 to 90; None: 30, and for `turn` as it
    looks best."""
    width: int = 960
    """Image width, px."""
    height: int = 540
    """Image height, px."""
    fov_y_deg: float | None = None
    """Vertical field of view, degrees (--fov for short); None: 50, and 65 from within a scene."""

    def __post_init__(self) -> None:
        check_literals(self)
        if not 1 <= self.views <= VIEWS_MAX:
            raise InputError(f"views: found {self.views}, wanted 1 to {VIEWS_MAX:,}")
        if not (1 <= self.width <= SIDE_MAX_PX and 1 <= self.height <= SIDE_MAX_PX):
            raise InputError(
                f"width, height: found {self.width} × {self.height}, wanted 1 × 1 px to {SIDE_MAX_PX:,} px a side"
            )
        if self.up is not None and not 0 < np.linalg.norm(self.up) < np.inf:
            raise InputError(f"up: found {self.up}, wanted a direction")
        if self.elevation_deg is not None and not -90 <= self.elevation_deg <= 90:
            raise InputError(f"elevation_deg: found {self.elevation_deg}, wanted -90 to 90")
        if self.fov_y_deg is not None and not 0 < self.fov_y_deg < 180:
            raise InputError(f"fov_y_deg: found {self.fov_y_deg}, wanted between 0 and 180")


@checked
def orbit(scene: Scene, options: PathOptions | None = None) -> Cameras:
    """Views on a circle around a scene that look at its centre, with 99 % of its opacity in the picture.

    Gaussians beyond 1.25 radii may be outside of the picture.

    Args:
        scene: any scene.
        options: number of views, size, elevation and field of view; None: the defaults.

    Returns:
        The views, at equal angles.

    Raises:
        InputError: the scene is empty.

    Example:
        >>> first, second = st.orbit(scene, st.PathOptions(views=2))
        >>> bool(np.linalg.norm(first.position - second.position) > 0)
        True
    """
    options = given(options, PathOptions, "options of a path")
    sample = _sample(scene)
    centre, radius = bounds_of_sample(sample)
    means, weights = sample.means.astype(np.float64), sample.opacities()
    radius = min(
        max(radius, _weighted_quantile(np.linalg.norm(means - centre, axis=1), weights, RIM_SHARE)), RIM_MAX * radius
    )
    half_y = np.radians(options.fov_y_deg or FOV_Y_DEG) / 2
    half_x = np.arctan(np.tan(half_y) * options.width / options.height)
    distance = radius / np.sin(min(half_x, half_y))
    turns = np.arange(options.views) / options.views
    return _cameras(_upright(scene, options), centre, turns, np.full(options.views, distance))


@checked
def flyout(scene: Scene, options: PathOptions | None = None, *, nearest: float = 0.3, farthest: float = 8.0) -> Cameras:
    """Views that move away from a scene, so that it runs through its levels.

    Each view is farther from the centre by the same factor.

    Args:
        scene: any scene.
        options: number of views, size, elevation and field of view; None: the defaults.
        nearest: distance of the first view, in radii of the scene.
        farthest: distance of the last view, in radii of the scene.

    Returns:
        The views, all in the same direction.

    Raises:
        InputError: the scene is empty, or the distances are not positive.

    Example:
        >>> drawn = [len(st.select(scene, view)) for view in st.flyout(scene, st.PathOptions(views=4))]
        >>> drawn[-1] <= len(scene)
        True
    """
    options = given(options, PathOptions, "options of a path")
    if not 0 < nearest <= farthest <= FARTHEST:
        raise InputError(
            f"flyout: found nearest {nearest} and farthest {farthest}, wanted 0 < nearest <= farthest <= {FARTHEST:,} radii"
        )
    centre, radius = bounds_of(scene)
    distances = radius * np.geomspace(nearest, farthest, options.views)
    return _cameras(_upright(scene, options), centre, np.zeros(options.views), distances)


@checked
def through(cameras: Sequence[Camera], views: int) -> Cameras:
    """A path of cameras through given ones, in their order.

    Centres move along straight lines, and directions turn evenly. Size, focal lengths and the near plane of a view are those of
    the last given camera that it has passed.

    Args:
        cameras: the cameras to pass.
        views: number of cameras of the path.

    Returns:
        The path; it begins at the first given camera and ends at the last one.

    Raises:
        InputError: there is no camera, or no view is asked for.

    Example:
        >>> len(st.through(cameras, 25))
        25
    """
    if not cameras or views < 1:
        raise InputError(f"through: found {len(cameras)} cameras and {views} views, wanted at least 1 of each")
    quats = np.array([quat_from_matrix(camera.camera_from_world[:3, :3]) for camera in cameras])
    places = np.linspace(0, len(cameras) - 1, views)
    path = []
    for i, place in enumerate(places):
        before = min(int(place), max(len(cameras) - 2, 0))
        after, share = min(before + 1, len(cameras) - 1), place - before
        pose = np.eye(4)
        pose[:3, :3] = matrices_from_quats(_between(quats[before], quats[after], share)[None])[0]
        pose[:3, 3] = -pose[:3, :3] @ ((1 - share) * cameras[before].position + share * cameras[after].position)
        passed = cameras[after if share == 1 else before]
        path.append(replace(passed, camera_from_world=pose, name=f"path_{i:04d}"))
    return Cameras(tuple(path))


def _between(a: Array, b: Array, share: float) -> Array:
    """The unit quaternion that turns ``share`` of the shorter way from a to b (Shoemake 1985)."""
    b = b if a @ b >= 0 else -b
    angle = float(np.arccos(np.clip(a @ b, -1, 1)))
    if angle < 1e-6:  # the sines vanish together: their ratio is the share itself
        return np.asarray(a + share * (b - a))
    return np.asarray((np.sin((1 - share) * angle) * a + np.sin(share * angle) * b) / np.sin(angle))


def bounds_of(scene: Scene) -> tuple[Float64[Array, "3"], float]:
    """Centre and radius, world units, of what is seen of a scene: see the head of this module."""
    return bounds_of_sample(_sample(scene))


def bounds_of_sample(sample: Gaussians) -> tuple[Float64[Array, "3"], float]:
    """The same of leaves that are spread evenly, every `sample_stride` rows."""
    means, weights = sample.means.astype(np.float64), sample.opacities()
    centre = np.array([_weighted_quantile(means[:, axis], weights, 0.5) for axis in range(3)])
    radius = _weighted_quantile(np.linalg.norm(means - centre, axis=1), weights, SHARE)
    if radius == 0:  # one Gaussian, or all at one place: its own size
        radius = float(sample.reach().max())
    return centre, radius


def sample_stride(num_leaves: int) -> int:
    """How far apart the rows are of which bounds are made."""
    return -(-num_leaves // SAMPLE)


def _sample(scene: Scene) -> Gaussians:
    """Leaves, evenly spread over the rows, without their colours."""
    check_is_scene(scene, "camera path")
    if len(scene) == 0:
        raise InputError("camera path: the scene is empty; name cameras instead")
    is_leaf = scene.tree.is_leaf
    step, num_before, rows = sample_stride(int(is_leaf.sum())), 0, list[Array]()
    for first in range(0, len(scene), _ROWS_AT_ONCE):  # numbers of all leaves would take more than what is asked for
        leaves = first + np.flatnonzero(is_leaf[first : first + _ROWS_AT_ONCE])
        rows.append(leaves[-num_before % step :: step])
        num_before += len(leaves)
    g, taken = scene.gaussians, np.concatenate(rows)
    return Gaussians(
        np.take(g.means, taken, axis=0),
        np.take(g.quats, taken, axis=0),
        np.take(g.log_scales, taken, axis=0),
        np.take(g.logit_opacities, taken, axis=0),
        np.zeros((len(taken), 1, 3), np.float32),
    )


def _weighted_quantile(values: Array, weights: Array, share: float) -> float:
    order = np.argsort(values, kind="stable")
    below = np.cumsum(weights[order])
    return float(values[order[np.searchsorted(below, share * below[-1])]])


@checked
def turn(framing: Framing, options: PathOptions | None = None) -> Cameras:
    """Views all round: about the target if the scene is seen from outside, about the eye if it is seen from within.

    Args:
        framing: how to look at the scene; its first view is the first one. The vertical is that of the framing.
        options: number of views, size, elevation and field of view; ``up`` is not used. None: the defaults.

    Returns:
        The views, at equal angles.

    Example:
        >>> len(st.turn(st.frame_scene(scene), st.PathOptions(views=12)))
        12
    """
    options = given(options, PathOptions, "options of a path")
    if options.elevation_deg is not None:
        framing = framing.raised(options.elevation_deg)
    first = framing.camera(options.width, options.height, fov_y_deg=options.fov_y_deg)
    views = []
    for i, angle in enumerate(np.arange(options.views) / options.views * 2 * np.pi):
        rotation = _about(framing.up, angle)
        pivot = framing.eye if framing.inside else framing.target
        eye, target = (pivot + rotation @ (point - pivot) for point in (framing.eye, framing.target))
        turned = Camera.look_at(eye, target, up=framing.up)
        views.append(replace(first, camera_from_world=turned.camera_from_world, name=f"view_{i:04d}"))
    return Cameras(tuple(views))


def _about(axis: Array, angle: float) -> Float64[Array, "3 3"]:
    """The rotation about a unit vector by an angle, rad."""
    return np.asarray(matrices_from_quats(np.append(np.cos(angle / 2), np.sin(angle / 2) * axis)[None])[0])


def _upright(scene: Scene, options: PathOptions) -> PathOptions:
    """The options with a direction that is up."""
    if options.up is not None:
        return options
    return replace(options, up=guess_up(survey_of(scene), scene.source).up)


def _cameras(options: PathOptions, centre: Array, turns: Array, distances: Array) -> Cameras:
    direction = directions_above(np.asarray(options.up, np.float64))
    elevation = np.radians(ELEVATION_DEG if options.elevation_deg is None else options.elevation_deg)
    views = []
    for i, (turned, distance) in enumerate(zip(turns, distances, strict=True)):
        eye = centre + distance * direction(2 * np.pi * turned, elevation)
        camera = Camera.look_at(
            eye,
            centre,
            up=np.asarray(options.up),
            width=options.width,
            height=options.height,
            fov_y_deg=options.fov_y_deg or FOV_Y_DEG,
        )
        views.append(replace(camera, near=min(NEAR, NEAR_SHARE * float(distance)), name=f"view_{i:04d}"))
    return Cameras(tuple(views))


def directions_above(up: Array) -> Callable[[float, float], Array]:
    """The unit vector at an azimuth and an elevation, rad, over the plane across ``up``."""
    up = up / np.linalg.norm(up)
    east = np.cross(up, np.eye(3)[np.argmin(np.abs(up))])
    east /= np.linalg.norm(east)
    north = np.cross(east, up)
    return lambda azimuth, elevation: (
        np.cos(elevation) * (np.cos(azimuth) * north + np.sin(azimuth) * east) + np.sin(elevation) * up
    )
