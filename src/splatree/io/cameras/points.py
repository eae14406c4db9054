"""The points of a COLMAP model, binary or text, or of nerfstudio: where training starts.

``points3D`` holds for each point its place, its colour, and the pictures that it was found in. Layout:
colmap.github.io/format.html. ``transforms.json`` names a .ply in ``ply_file_path``, with places in the frame of its poses.
"""

import struct
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from splatree.errors import FormatError, InputError
from splatree.io import untrusted
from splatree.io.cameras import colmap
from splatree.io.cameras.files import COLMAP_FOLDERS
from splatree.io.cameras.nerfstudio import TRANSFORMS, training_frame
from splatree.io.cameras.point_cloud import FARTHEST, read_point_cloud
from splatree.shapes import Array, Float64, Int32, UInt8, check_fields

__all__ = ["Points", "read_points"]

_HEAD = struct.Struct("<Q3d3BdQ")
"""Number, place, colour, error, and how many pictures follow, 8 bytes each."""


@dataclass(frozen=True, eq=False)
class Points:
    """Points that were found in pictures."""

    places: Float64[Array, "n 3"]
    """World units."""
    colors: UInt8[Array, "n 3"]
    """RGB, 0 to 255."""
    num_pictures: Int32[Array, "n"]
    """Pictures that each point was found in; 0 where the file does not say."""

    def __post_init__(self) -> None:
        check_fields(self)

    def __len__(self) -> int:
        return len(self.places)


def read_points(root: Path) -> Points | None:
    """The points that belong to the cameras which `read_cameras` finds in a folder; None if there are none.

    They are those of its COLMAP model, or else of the .ply that its transforms.json names.

    Raises:
        InputError: the .ply is not there.
        FormatError: a file is damaged.
    """
    models = [model for folder in COLMAP_FOLDERS for model in colmap.models_in(root / folder)] if root.is_dir() else []
    for name, read in (("points3D.bin", _binary), ("points3D.txt", _text)):
        if models and (models[0] / name).is_file():
            points = read(models[0] / name)
            wrong = np.flatnonzero(~(np.abs(points.places) <= FARTHEST).all(axis=1))
            if len(wrong):
                raise FormatError(
                    f"{models[0] / name}: point {wrong[0] + 1} of {len(points)}: found {points.places[wrong[0]]}, wanted places "
                    f"within {FARTHEST:g} of zero"
                )
            matrix, scale = training_frame(root)
            places = scale * (points.places @ matrix[:3, :3].T + matrix[:3, 3])
            return Points(np.ascontiguousarray(places), points.colors, points.num_pictures) if len(points) else None
    return None if models else _of_nerfstudio(root / TRANSFORMS if root.is_dir() else root)


def _of_nerfstudio(path: Path) -> Points | None:
    """The points that a transforms.json names; None if it is none, or names none."""
    if path.suffix.lower() != ".json" or not path.is_file():
        return None
    content = untrusted.read_json(path)
    if not isinstance(content, dict) or "ply_file_path" not in content:
        return None
    name = untrusted.text(content, "ply_file_path", str(path))
    try:
        places, colors = read_point_cloud(path.parent / name)
    except InputError as error:
        raise type(error)(f"{path}: ply_file_path: {error}") from error
    matrix, scale = training_frame(path.parent, content)
    places = np.ascontiguousarray(scale * (places @ matrix[:3, :3].T + matrix[:3, 3]))
    return Points(places, colors, np.zeros(len(places), np.int32)) if len(places) else None


def _binary(path: Path) -> Points:
    data = path.read_bytes()
    count = struct.unpack_from("<Q", data)[0] if len(data) >= 8 else 0
    if len(data) < 8 + count * _HEAD.size:
        raise FormatError(
            f"{path}: found {len(data)} bytes, wanted at least {8 + count * _HEAD.size}; the file is cut off"
        )
    places, colors = np.empty((count, 3)), np.empty((count, 3), np.uint8)
    num_pictures, at = np.empty(count, np.int32), 8
    for i in range(count):
        if at + _HEAD.size > len(data):
            raise FormatError(
                f"{path}: found {len(data)} bytes, which end in point {i + 1} of {count}; the file is cut off"
            )
        _, *numbers, _, pictures = _HEAD.unpack_from(data, at)
        places[i], colors[i], num_pictures[i] = numbers[:3], numbers[3:], min(pictures, 2**31 - 1)
        at += _HEAD.size + 8 * pictures
    if at > len(data):
        raise FormatError(f"{path}: found {len(data)} bytes, wanted {at}; the file is cut off")
    return Points(places, colors, num_pictures)


def _text(path: Path) -> Points:
    places, colors, num_pictures = [], [], []
    for number, line in enumerate(path.read_text(encoding="utf-8", errors="replace").splitlines(), start=1):
        if not line.strip() or line.startswith("#"):
            continue
        words = line.split()
        try:
            places.append([float(word) for word in words[1:4]])
            color = [int(word) for word in words[4:7]]
            if len(words) < 8 or not all(0 <= channel <= 255 for channel in color):
                raise ValueError("too few numbers, or no colour")
        except ValueError as error:
            raise FormatError(
                f"{path}: line {number}: found {line[:80]!r}, wanted POINT3D_ID X Y Z R G B ERROR and pictures"
            ) from error
        colors.append(color)
        num_pictures.append((len(words) - 8) // 2)
    return Points(
        np.array(places, np.float64).reshape(-1, 3),
        np.array(colors, np.uint8).reshape(-1, 3),
        np.array(num_pictures, np.int32),
    )
