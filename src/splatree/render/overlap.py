"""Whether cameras see a scene at all, and two scenes lie in one place: if not, they are most likely in other coordinates."""

from collections.abc import Sequence

import numpy as np

from splatree.render.paths import bounds_of
from splatree.scene.cameras import Camera
from splatree.scene.scene import Scene

__all__ = ["overlap_hint", "place_hint"]

_CAMERAS = 64
_ROWS = 4096
"""Cameras and Gaussians that are looked at, spread evenly."""

_APART = 0.25
"""Radii between the middles of two scenes that lie in other places; what is lost moves a middle by a few percent."""


def overlap_hint(scene: Scene, cameras: Sequence[Camera]) -> str | None:
    """A sentence that says why none of the cameras may see the scene; None if one does, or there is nothing to see."""
    if not len(scene) or not len(cameras):
        return None
    rows = np.flatnonzero(scene.tree.is_leaf)
    points = scene.gaussians.means[rows[:: max(1, len(rows) // _ROWS)]].astype(np.float64)
    for camera in cameras[:: max(1, len(cameras) // _CAMERAS)]:
        x, y, z = camera.camera_from_world[:3, :3] @ points.T + camera.camera_from_world[:3, 3:]
        seen = z > camera.near
        across = camera.K[0, 0] * x[seen] / z[seen] + camera.K[0, 2]
        down = camera.K[1, 1] * y[seen] / z[seen] + camera.K[1, 2]
        margin = 1.0 if camera.lens else 0.1  # a lens shows more than its pinhole; a Gaussian is larger than its centre
        inside = (np.abs(across / camera.width - 0.5) < 0.5 + margin) & (
            np.abs(down / camera.height - 0.5) < 0.5 + margin
        )
        if inside.any():
            return None
    centre, radius = bounds_of(scene)
    distances = [float(np.linalg.norm(camera.position - centre)) for camera in cameras]
    return (
        f"none of the {len(cameras)} cameras sees the scene: they are {min(distances):.4g} and more from its middle, and its "
        f"radius is {radius:.4g}. Cameras and scene may be in other coordinates: nerfstudio trains in a frame of its own (put "
        "its dataparser_transforms.json beside transforms.json, and the cameras are taken there); applied_transform of "
        "transforms.json has moved its poses away from COLMAP's; or one of the two was turned or moved"
    )


def place_hint(scene: Scene, reference: Scene) -> str | None:
    """A sentence that says how far apart two scenes of one thing lie; None if they lie in one place."""
    if not len(scene) or not len(reference):
        return None
    (centre, radius), (wanted, wanted_radius) = bounds_of(scene), bounds_of(reference)
    apart = float(np.linalg.norm(centre - wanted))
    if apart <= _APART * wanted_radius and 1 / 1.5 < radius / wanted_radius < 1.5:
        return None
    return (
        f"the scenes do not lie in one place: their middles are {apart:.4g} apart, and their radii are {radius:.4g} and "
        f"{wanted_radius:.4g}. One was moved, scaled or cropped, or its axes point elsewhere (--input-axes, --rotate)"
    )
