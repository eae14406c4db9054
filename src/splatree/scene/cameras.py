"""Cameras with OpenCV axes: x right, y down, z forward; pixel centres at +½; pinholes, or with a lens that bends lines."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from splatree.constants import NEAR
from splatree.errors import InputError
from splatree.scene.lens import Lens
from splatree.scene.scene import Source
from splatree.shapes import Array, Float64, check_fields

SIDE_MAX_PX = 2**31 - 1
"""Kernels count the pixels of a side with 32 bits."""

ROTATION_TOLERANCE = 1e-4
"""How far R Rᵀ may be from the identity: four digits of a rotation are off by less."""


@dataclass(frozen=True, eq=False)
class Camera:
    """One view: where the camera is, and how it projects.

    Axes are those of OpenCV: x right, y down, z forward. The centre of the first pixel is at (½, ½).

    Example:
        >>> camera = st.Camera.look_at([0, -80, -120], [0, 0, 0], width=640, height=360)
        >>> camera.position.round(6).tolist()
        [0.0, -80.0, -120.0]
        >>> camera.scaled(0.5).width
        320
    """

    camera_from_world: Float64[Array, "4 4"]
    """Rigid transform: ``x_camera = R x_world + t``."""
    K: Float64[Array, "3 3"]
    """Intrinsics in px: fx, fy on the diagonal, cx, cy in the last column, no skew."""
    width: int
    """Image width, px."""
    height: int
    """Image height, px."""
    near: float = NEAR
    """Gaussians whose centre has a smaller view depth, world units, are not drawn."""
    name: str = ""
    """Name of the picture that the camera belongs to, if there is one."""
    lens: Lens | None = None
    """How the camera bends straight lines; None: not at all. `render` and `trace` draw it through a covering pinhole
    (scene/warp.py)."""

    def __post_init__(self) -> None:
        check_fields(self)
        if not isinstance(self.near, int | float | np.integer | np.floating):
            raise InputError(f"camera {self.name!r}: found near = {self.near!r}, wanted a number")
        if not all(isinstance(size, int | np.integer) for size in (self.width, self.height)):
            raise InputError(
                f"camera {self.name!r}: found size {self.width} × {self.height}, wanted whole numbers of pixels"
            )
        if not (0 < self.width <= SIDE_MAX_PX and 0 < self.height <= SIDE_MAX_PX):
            raise InputError(
                f"camera {self.name!r}: found size {self.width} × {self.height}, wanted 1 × 1 px to {SIDE_MAX_PX:,} px a side"
            )
        if not (np.isfinite(self.camera_from_world).all() and np.isfinite(self.K).all()):
            raise InputError(f"camera {self.name!r}: found NaN or infinity in its pose or intrinsics")
        if not (self.K[0, 0] > 0 and self.K[1, 1] > 0):
            raise InputError(f"camera {self.name!r}: found focal lengths {self.K[0, 0]}, {self.K[1, 1]}, wanted > 0 px")
        rotation = self.camera_from_world[:3, :3]
        if not np.allclose(rotation @ rotation.T, np.eye(3), atol=ROTATION_TOLERANCE) or np.linalg.det(rotation) < 0:
            raise InputError(f"camera {self.name!r}: its rotation is not orthonormal with determinant +1")
        if not (np.isfinite(self.near) and self.near > 0):
            raise InputError(f"camera {self.name!r}: found near = {self.near}, wanted > 0")

    @property
    def position(self) -> Float64[Array, "3"]:
        """Centre of projection in the world."""
        rotation, translation = self.camera_from_world[:3, :3], self.camera_from_world[:3, 3]
        return np.asarray(-rotation.T @ translation)

    def scaled(self, factor: float) -> "Camera":
        """The same view with ``factor`` times the pixels along each side (rounded).

        Raises:
            InputError: the factor is not above 0, or the picture would have too many pixels.
        """
        if not 0 < factor * max(self.width, self.height) <= SIDE_MAX_PX:
            raise InputError(
                f"scale: found {factor}, wanted more than 0 and sides of at most {SIDE_MAX_PX:,} px; "
                f"camera {self.name!r} has {self.width} × {self.height} px"
            )
        return self.resized(max(1, round(self.width * factor)), max(1, round(self.height * factor)))

    def resized(self, width: int, height: int) -> "Camera":
        """The same view with another number of pixels along each side."""
        K = self.K.copy()
        K[0] *= width / self.width
        K[1] *= height / self.height
        return replace(self, K=K, width=width, height=height)

    def moved(self, offset: Array) -> "Camera":
        """The same view in a world whose origin lies at ``offset``: the camera's position less ``offset``."""
        pose = self.camera_from_world.copy()
        pose[:3, 3] += pose[:3, :3] @ np.asarray(offset, np.float64)
        return replace(self, camera_from_world=pose)

    @staticmethod
    def look_at(
        position: Array,
        target: Array,
        *,
        up: Array = (0.0, -1.0, 0.0),  # type: ignore[assignment]
        width: int = 960,
        height: int = 540,
        fov_y_deg: float = 50.0,
    ) -> "Camera":
        """A camera at ``position`` that looks at ``target``.

        Args:
            position: centre of projection, world units.
            target: point that is in the middle of the picture.
            up: direction in the world that points upwards in the picture; most 3DGS scenes have y down.
            width: width of the picture, px.
            height: height of the picture, px.
            fov_y_deg: vertical field of view, degrees.

        Returns:
            The camera.

        Raises:
            InputError: position and target are the same point, or no points.
        """
        try:
            position, target, up = (np.asarray(v, np.float64) for v in (position, target, up))
        except (TypeError, ValueError) as error:
            raise InputError(f"look_at: found what is no point ({error}), wanted x y z") from error
        for name, value in (("width", width), ("height", height), ("fov_y_deg", fov_y_deg)):
            if not isinstance(value, int | float | np.integer | np.floating):
                raise InputError(f"look_at: {name}: found {value!r}, wanted a number")
        if not 0 < fov_y_deg < 180:
            raise InputError(f"look_at: found fov_y_deg {fov_y_deg}, wanted more than 0, less than 180 degrees")
        if not all(vector.shape == (3,) and np.isfinite(vector).all() for vector in (position, target, up)):
            raise InputError(
                f"look_at: found position {position}, target {target} and up {up}, wanted x y z of each, finite"
            )
        forward = target - position
        if not np.linalg.norm(forward) > 0:
            raise InputError("look_at: position and target are the same point")
        forward = forward / np.linalg.norm(forward)
        right = np.cross(forward, up)
        if np.linalg.norm(right) < 1e-9:  # looking along `up`: any horizontal will do
            right = np.cross(forward, np.roll(forward, 1) + np.array([0.0, 0.0, 1e-3]))
        right = right / np.linalg.norm(right)
        down = np.cross(forward, right)
        pose = np.eye(4)
        pose[:3, :3] = np.stack([right, down, forward])
        pose[:3, 3] = -pose[:3, :3] @ position
        focal = 0.5 * height / np.tan(np.radians(fov_y_deg) / 2)
        K = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])
        return Camera(pose, K, width, height)


def several(cameras: Iterable["Camera"]) -> list["Camera"]:
    """The cameras as a list.

    Raises:
        InputError: it is one camera, or something in it is none.
    """
    if isinstance(cameras, Camera) or not isinstance(cameras, Iterable):
        found = "one Camera" if isinstance(cameras, Camera) else type(cameras).__name__
        raise InputError(
            f"cameras: found {found}, wanted some, such as [camera], or what splatree.read_cameras returns"
        )
    views = list(cameras)
    for camera in views:
        check_is_camera(camera)
    return views


def check_is_camera(camera: object) -> None:
    """Say how to come by a camera, where something else is given.

    Raises:
        InputError: ``camera`` is none.
    """
    if not isinstance(camera, Camera):
        raise InputError(
            f"camera: found {type(camera).__name__}, wanted one Camera; make one with Camera.look_at, read some with "
            "splatree.read_cameras, draw several with splatree.render_batch"
        )


@dataclass(frozen=True, eq=False)
class Cameras:
    """Views in order.

    Example:
        >>> cameras = st.Cameras((camera, camera.scaled(2)))
        >>> [view.width for view in cameras]
        [64, 128]
    """

    views: tuple[Camera, ...]
    """The cameras."""
    notes: tuple[str, ...] = ()
    """What the reader of their file chose or left out, a sentence each."""

    def relative_to(self, source: Source) -> "Cameras":
        """The same views of a scene, by its ``source``: in its coordinates and, if they say nothing else, from its depth on."""
        views = [camera.moved(np.asarray(source.origin)) if any(source.origin) else camera for camera in self.views]
        return replace(self, views=tuple(replace(v, near=source.near) if v.near == NEAR else v for v in views))

    def __len__(self) -> int:
        return len(self.views)

    def __iter__(self) -> Iterator[Camera]:
        return iter(self.views)

    def __getitem__(self, index: int) -> Camera:
        return self.views[index]
