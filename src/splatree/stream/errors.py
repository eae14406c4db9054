"""How much each level of a chunk looks like its finest: the tables `errors` of a streamed SOG, which PlayCanvas 2.22 reads.

A chunk is drawn alone from six sides, so far away that the pictures are nearly parallel projections. The error of a level is

    Σ |p − p₀|² / Σ |p₀|²

over all pixels of the six pictures; p is premultiplied RGBA of the level, p₀ that of the finest level. A coarser level gets at
least the error of the finer one. Pixels are about half as wide as the small Gaussians of the chunk are long, within 64 to 512
pixels a side.

Cost: six small pictures for each level of each chunk, about 20 CPU-seconds a million Gaussians.
"""

from collections.abc import Sequence

import numpy as np

from splatree.render.session import open_session
from splatree.scene.cameras import Camera
from splatree.scene.gaussians import Gaussians
from splatree.scene.names import Mode
from splatree.scene.scene import Scene
from splatree.shapes import Array, Float32, Float64

__all__ = ["chunk_pictures", "chunk_views", "errors_of_levels"]

_DISTANCE = 200.0
"""Of the eye from the chunk's centre, in radii."""

_MARGIN = 1.05
"""Half the width of the picture, in radii."""

_TURN_DEG = (45.0, 20.0, 35.0)
"""Turns about x, y and z that keep the six sides from looking along walls."""

_SMALL = 0.1
"""Quantile of the Gaussians' largest scales that sets the pixel."""

_SIDE_MIN_PX, _SIDE_MAX_PX, _SIDE_STEP_PX = 64, 512, 16


def errors_of_levels(levels: Sequence[Gaussians], box: Float64[Array, "2 3"], mode: Mode) -> Float64[Array, "l"]:
    """The error of each level of a chunk that lies in the box, finest first."""
    cameras = chunk_views(levels[0], box)
    wanted = chunk_pictures(levels[0], cameras, mode)
    total = sum(float(np.square(picture, dtype=np.float64).sum()) for picture in wanted)
    errors = np.zeros(len(levels))
    for level, gaussians in enumerate(levels[1:], start=1):
        pictures = chunk_pictures(gaussians, cameras, mode)
        apart = sum(float(np.square(a - b, dtype=np.float64).sum()) for a, b in zip(pictures, wanted, strict=True))
        errors[level] = apart / total if total > 0 else 0.0
    return np.asarray(np.maximum.accumulate(errors))


def chunk_views(finest: Gaussians, box: Float64[Array, "2 3"], *, most_px: int = _SIDE_MAX_PX) -> list[Camera]:
    """The six views of a chunk that lies in the box, of at most ``most_px`` a side."""
    radius = max(float(np.linalg.norm(box[1] - box[0])) / 2, 1e-12)
    small = np.quantile(np.exp(finest.log_scales.max(axis=1).astype(np.float64)), _SMALL)
    side = float(np.clip(2 * radius / max(small, 1e-30), _SIDE_MIN_PX, most_px))
    side_px = int(np.ceil(side / _SIDE_STEP_PX)) * _SIDE_STEP_PX
    rotation, centre = _turn(), box.mean(axis=0)
    focal = side_px * _DISTANCE / (2 * _MARGIN)
    K = np.array([[focal, 0, side_px / 2], [0, focal, side_px / 2], [0, 0, 1]])
    cameras = []
    for axis in range(3):
        for sign in (1.0, -1.0):
            away = sign * rotation[:, axis]
            eye = centre + _DISTANCE * radius * away
            pose = Camera.look_at(eye, centre, up=rotation[:, (axis + 1) % 3], width=side_px, height=side_px)
            cameras.append(Camera(pose.camera_from_world, K, side_px, side_px, near=radius))
    return cameras


def _turn() -> Float64[Array, "3 3"]:
    """About x first, then y, then z."""
    product = np.eye(3)
    for axis, degrees in enumerate(np.radians(_TURN_DEG)):
        one, other = (axis + 1) % 3, (axis + 2) % 3
        turn = np.eye(3)
        turn[one, one] = turn[other, other] = np.cos(degrees)
        turn[other, one], turn[one, other] = np.sin(degrees), -np.sin(degrees)
        product = turn @ product
    return product


def chunk_pictures(gaussians: Gaussians, views: Sequence[Camera], mode: Mode) -> list[Float32[Array, "h w 4"]]:
    """The Gaussians in each view, premultiplied RGBA."""
    with open_session(Scene.flat(gaussians, mode=mode)) as session:
        drawn = [session.draw(view) for view in views]
    return [np.concatenate([one.image, one.alpha[:, :, None]], axis=2) for one in drawn]
