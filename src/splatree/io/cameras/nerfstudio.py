"""Views of ``transforms.json`` (nerfstudio, instant-ngp).

Each frame has a camera-to-world matrix with OpenGL axes (x right, y up, z back); flipping its y and z columns gives OpenCV's.
Intrinsics ``fl_x fl_y cx cy w h`` and distortion ``k1 … p2`` stand in the file's top level or in a frame, which wins; the
field of view ``camera_angle_x`` replaces focal lengths, and the size of the first picture a missing ``w h``. Poses are taken
as they are written: ``applied_transform`` has moved them already. Frames that name the same lens share nothing.
"""

from collections import ChainMap
from pathlib import Path
from typing import Any

import numpy as np

from splatree.errors import FormatError, InputError
from splatree.io import untrusted
from splatree.io.cameras.distortion import lens_of_record
from splatree.io.images import image_size
from splatree.scene.cameras import Camera, Cameras


@np.errstate(over="ignore", invalid="ignore", divide="ignore")  # absurd numbers become infinite, which Camera refuses
def parse(content: dict[str, Any], path: Path) -> Cameras:
    """The frames in order."""
    frames = untrusted.as_list(content["frames"], f"{path}: frames")
    return Cameras(tuple(_view(frame, content, path, f"{path}: frame {i}") for i, frame in enumerate(frames)))


def _view(value: Any, content: dict[str, Any], path: Path, where: str) -> Camera:
    frame = untrusted.as_object(value, where)
    lens = ChainMap(frame, content)  # a frame's own values win
    name = untrusted.text(frame, "file_path", where) if "file_path" in frame else ""
    if "w" in lens and "h" in lens:
        width, height = untrusted.integer(lens, "w", where, low=1), untrusted.integer(lens, "h", where, low=1)
    else:
        width, height = _size_of_picture(path.parent, name, where)
    fx = _focal(lens, "x", width, where)
    fy = _focal(lens, "y", height, where) if "fl_y" in lens or "camera_angle_y" in lens else fx
    cx = untrusted.number(lens, "cx", where) if "cx" in lens else width / 2
    cy = untrusted.number(lens, "cy", where) if "cy" in lens else height / 2
    K = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]], np.float64)

    world_from_camera = untrusted.numbers(frame, "transform_matrix", where, (4, 4)) @ np.diag([1.0, -1.0, -1.0, 1.0])
    rotation = world_from_camera[:3, :3].T
    pose = np.eye(4)
    pose[:3, :3] = rotation
    pose[:3, 3] = -rotation @ world_from_camera[:3, 3]
    try:
        return Camera(pose, K, width, height, name=name, lens=lens_of_record(lens, where))
    except InputError as error:
        if isinstance(error, FormatError):
            raise
        raise FormatError(f"{where}: {error}") from error


def _focal(lens: ChainMap[str, Any], axis: str, size: int, where: str) -> float:
    if f"fl_{axis}" in lens:
        return untrusted.number(lens, f"fl_{axis}", where)
    if f"camera_angle_{axis}" in lens:
        return float(0.5 * size / np.tan(untrusted.number(lens, f"camera_angle_{axis}", where) / 2))
    raise FormatError(f"{where}: found no fl_{axis} and no camera_angle_{axis}, wanted a focal length")


def _size_of_picture(folder: Path, name: str, where: str) -> tuple[int, int]:
    for candidate in (folder / name, folder / f"{name}.png"):  # Blender's synthetic scenes leave the suffix out
        if name and candidate.is_file():
            return image_size(candidate)
    raise FormatError(f"{where}: found no w and h and no picture {name!r} to take them from, wanted a size")
