"""Views of ``transforms.json`` (nerfstudio, instant-ngp).

Each frame has a camera-to-world matrix with OpenGL axes (x right, y up, z back); flipping its y and z columns gives OpenCV's.
Intrinsics ``fl_x fl_y cx cy w h`` and distortion ``k1 … p2`` stand in the file's top level or in a frame, which wins; the
field of view ``camera_angle_x`` replaces focal lengths, and the size of the picture, or of another frame's, a missing ``w h``.
Poses are taken as they are written: ``applied_transform`` has moved them already.

nerfstudio trains in a frame of its own. Where the ``dataparser_transforms.json`` of a training lies beside the cameras, they are
moved there: it holds a matrix T and a scale s from the poses before ``applied_transform`` A, so x' = s / s_A · T A⁻¹ x.
"""

from collections import ChainMap
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from splatree.errors import FormatError, InputError
from splatree.io import untrusted
from splatree.io.cameras.distortion import lens_of_record
from splatree.io.cameras.poses import Rotations
from splatree.io.images import image_size
from splatree.io.photo_search import SUFFIXES
from splatree.scene.cameras import Camera, Cameras
from splatree.shapes import Array, Float64

__all__ = ["DATAPARSER", "TRANSFORMS", "in_training_frame", "parse", "training_frame"]

DATAPARSER, TRANSFORMS = "dataparser_transforms.json", "transforms.json"


@np.errstate(over="ignore", invalid="ignore", divide="ignore")  # absurd numbers become infinite, which Camera refuses
def parse(content: dict[str, Any], path: Path) -> Cameras:
    """The frames in order."""
    frames = untrusted.as_list(content["frames"], f"{path}: frames")
    sizes, rotations = _Sizes(path.parent), Rotations()
    views = tuple(_view(frame, content, sizes, rotations, f"{path}: frame {i}") for i, frame in enumerate(frames))
    return in_training_frame(Cameras(views, (*sizes.notes, *rotations.notes)), path.parent, content)


def in_training_frame(cameras: Cameras, folder: Path, content: Mapping[str, Any] | None = None) -> Cameras:
    """The cameras in the frame of a training of nerfstudio, if its dataparser_transforms.json lies in the folder.

    Args:
        cameras: as their file has them.
        folder: where that file lies.
        content: of a transforms.json, whose numbers were moved already; None: they were not.

    Raises:
        FormatError: the file is damaged.
    """
    path = folder / DATAPARSER
    if not path.is_file():
        return cameras
    matrix, scale = training_frame(folder, content)
    views = []
    for camera in cameras:
        rotation = camera.camera_from_world[:3, :3] @ matrix[:3, :3].T
        position = scale * (matrix[:3, :3] @ camera.position + matrix[:3, 3])
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = rotation, -rotation @ position
        try:
            views.append(replace(camera, camera_from_world=pose))
        except InputError as error:
            raise FormatError(f"{path}: {error}") from error
    note = f"the cameras are moved into the frame of the training by {path.name}, which lies beside them"
    return replace(cameras, views=tuple(views), notes=(*cameras.notes, note))


def training_frame(folder: Path, content: Mapping[str, Any] | None = None) -> tuple[Float64[Array, "4 4"], float]:
    """The move of dataparser_transforms.json, and the scale that comes after it; none and 1 without the file.

    Args:
        folder: where it lies.
        content: of a transforms.json, from whose numbers they are; None: from those of a COLMAP model.
    """
    path, matrix = folder / DATAPARSER, np.eye(4)
    if not path.is_file():
        return matrix, 1.0
    record = untrusted.as_object(untrusted.read_json(path), str(path))
    matrix[:3] = untrusted.numbers(record, "transform", str(path), (3, 4))
    scale, applied, applied_scale = untrusted.number(record, "scale", str(path)), np.eye(4), 1.0
    where = str(folder / TRANSFORMS)
    if content is not None and "applied_transform" in content:
        applied[:3] = untrusted.numbers(content, "applied_transform", where, (3, 4))
    if content is not None and "applied_scale" in content:
        applied_scale = untrusted.number(content, "applied_scale", where)
    if not (scale > 0 and applied_scale > 0):
        raise FormatError(f"{path}: found the scales {scale} and {applied_scale}, wanted more than 0")
    try:
        return matrix @ np.linalg.inv(applied), scale / applied_scale
    except np.linalg.LinAlgError as error:
        raise FormatError(
            f"{path}: found an applied_transform without an inverse, wanted a rotation and a move"
        ) from error


class _Sizes:
    """Sizes of pictures, for frames without ``w h``: of their own, or else that of another frame."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._last: tuple[int, int] | None = None
        self.notes: tuple[str, ...] = ()

    def of(self, name: str, where: str) -> tuple[int, int]:
        """The size of the picture of that name."""
        plain = name.replace("\\", "/")
        suffixes = ("", *SUFFIXES, *(suffix.upper() for suffix in SUFFIXES))  # Blender's synthetic scenes leave it out
        for candidate in (self._folder / f"{plain}{suffix}" for suffix in suffixes):
            if name and candidate.is_file():
                self._last = image_size(candidate)
                return self._last
        if self._last is None:
            raise FormatError(f"{where}: found no w and h and no picture {name!r} to take them from, wanted a size")
        self.notes = (
            "some frames have neither w and h nor a picture: they are taken to be as large as those before them",
        )
        return self._last


def _view(value: Any, content: dict[str, Any], sizes: _Sizes, rotations: Rotations, where: str) -> Camera:
    frame = untrusted.as_object(value, where)
    lens = ChainMap(frame, content)  # a frame's own values win
    name = untrusted.text(frame, "file_path", where) if "file_path" in frame else ""
    if "w" in lens and "h" in lens:
        width, height = untrusted.integer(lens, "w", where, low=1), untrusted.integer(lens, "h", where, low=1)
    else:
        width, height = sizes.of(name, where)
    fx = _focal(lens, "x", width, where)
    fy = _focal(lens, "y", height, where) if "fl_y" in lens or "camera_angle_y" in lens else fx
    cx = untrusted.number(lens, "cx", where) if "cx" in lens else width / 2
    cy = untrusted.number(lens, "cy", where) if "cy" in lens else height / 2
    K = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]], np.float64)

    rows = frame.get("transform_matrix")
    shape = (3, 4) if isinstance(rows, list) and len(rows) == 3 else (4, 4)  # some leave the row 0 0 0 1 out
    world_from_camera = untrusted.numbers(frame, "transform_matrix", where, shape) @ np.diag([1.0, -1.0, -1.0, 1.0])
    rotation = rotations.of(world_from_camera[:3, :3], where).T
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
