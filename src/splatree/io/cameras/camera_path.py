"""Views of a ``camera_path.json``, which nerfstudio's viewer saves: one pinhole a frame of a film.

Each frame has a camera-to-world matrix, row by row, with OpenGL axes (x right, y up, z back), and the vertical field of view in
degrees. Coordinates are those of the trained scene, as nerfstudio exports it.
"""

from pathlib import Path
from typing import Any

import numpy as np

from splatree.errors import FormatError, InputError
from splatree.io import untrusted
from splatree.io.cameras.poses import Rotations
from splatree.scene.cameras import Camera, Cameras

__all__ = ["parse"]


@np.errstate(over="ignore", invalid="ignore", divide="ignore")  # absurd numbers become infinite, which Camera refuses
def parse(content: dict[str, Any], path: Path) -> Cameras:
    """The frames in order, at the size that the file says."""
    kind = content.get("camera_type", "perspective")
    if kind != "perspective":
        raise FormatError(
            f"{path}: found camera_type {str(kind)[:40]!r}, wanted 'perspective': other kinds are not drawn"
        )
    width, height = (untrusted.integer(content, f"render_{side}", str(path), low=1) for side in ("width", "height"))
    frames = untrusted.as_list(content["camera_path"], f"{path}: camera_path")
    rotations = Rotations()
    views = tuple(_view(value, i, (width, height), rotations, path) for i, value in enumerate(frames))
    return Cameras(views, rotations.notes)


def _view(value: Any, number: int, size: tuple[int, int], rotations: Rotations, path: Path) -> Camera:
    where, (width, height) = f"{path}: frame {number}", size
    frame = untrusted.as_object(value, where)
    matrix = frame.get("camera_to_world")
    shape = (4, 4) if isinstance(matrix, list) and len(matrix) == 4 else (16,)
    world_from_camera = untrusted.numbers(frame, "camera_to_world", where, shape).reshape(4, 4) @ np.diag(
        [1.0, -1, -1, 1]
    )
    focal = 0.5 * height / np.tan(np.radians(untrusted.number(frame, "fov", where)) / 2)
    pose = np.eye(4)
    pose[:3, :3] = rotations.of(world_from_camera[:3, :3], where).T
    pose[:3, 3] = -pose[:3, :3] @ world_from_camera[:3, 3]
    K = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])
    try:
        return Camera(pose, K, width, height, name=f"frame_{number:05d}")
    except InputError as error:
        raise FormatError(f"{where}: {error}") from error
