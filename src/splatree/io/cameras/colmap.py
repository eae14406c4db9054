"""Views of a COLMAP sparse model, binary or text.

``images`` holds for each picture the unit quaternion wxyz and the translation of world-to-camera, and its camera's number;
``cameras`` the model, size and parameters of each camera. Axes are OpenCV's and the centre of the first pixel is (½, ½), as
here. Points are not read. Layouts: colmap.github.io/format.html.
"""

import math
import struct
from pathlib import Path

import numpy as np

from splatree.errors import FormatError, InputError
from splatree.io.cameras.distortion import NUMBERED, intrinsics
from splatree.scene.cameras import Camera, Cameras
from splatree.shapes import Array

_Lenses = dict[int, tuple[str, tuple[float, ...], int, int, str]]
"""Model, parameters, width, height and place in the file by the camera's number; looked at when a picture uses it."""
_Pose = tuple[str, tuple[float, ...], int]  # name of the picture, quaternion and translation, the camera's number


def models_in(folder: Path) -> list[Path]:
    """The models in a folder: its numbered folders, the one with most pictures first, or itself."""
    numbered = [child for child in folder.glob("*") if child.name.isdigit() and is_model(child)]
    numbered.sort(key=lambda child: int(child.name))
    if len(numbered) > 1:
        numbered.sort(key=lambda child: -num_pictures(child))
    return numbered or ([folder] if is_model(folder) else [])


def half_model_in(folder: Path) -> str | None:
    """A file of a model in a folder, or in a numbered one in it, whose other half is missing, and that half."""
    for child in (folder, *(child for child in folder.glob("*") if child.name.isdigit())):
        for there, missing in (("images", "cameras"), ("cameras", "images")):
            for suffix in (".bin", ".txt"):
                if (child / f"{there}{suffix}").is_file():
                    return f"{child / there}{suffix} without {missing}{suffix} beside it"
    return None


def num_pictures(folder: Path) -> int:
    """How many pictures a model has."""
    if (folder / "images.bin").is_file():
        return len(_images_bin(folder / "images.bin"))
    return len(_images_txt(folder / "images.txt"))


def is_model(folder: Path) -> bool:
    """Whether a folder holds the cameras and images of a model."""
    return any(
        all((folder / f"{name}{suffix}").is_file() for name in ("cameras", "images")) for suffix in (".bin", ".txt")
    )


@np.errstate(over="ignore", invalid="ignore")  # absurd numbers become infinite, which Camera refuses
def read(folder: Path) -> Cameras:
    """Read all views, ordered by the names of their pictures; binary files are preferred to text."""
    if (folder / "images.bin").is_file() and (folder / "cameras.bin").is_file():
        lenses, poses = _cameras_bin(folder / "cameras.bin"), _images_bin(folder / "images.bin")
    else:
        lenses, poses = _cameras_txt(folder / "cameras.txt"), _images_txt(folder / "images.txt")
    views, num_long = [], 0
    for name, numbers, camera in sorted(poses, key=lambda pose: pose[0]):
        where = f"{folder}: picture {name!r}"
        if camera not in lenses:
            raise FormatError(f"{where}: found camera number {camera}, wanted one of {sorted(lenses)[:12]}")
        model, parameters, width, height, place = lenses[camera]
        K, lens = intrinsics(model, parameters, place)
        num_long += not 0.5 < np.linalg.norm(numbers[:4]) < 2
        try:
            views.append(Camera(_pose(numbers, where), K, width, height, name=name, lens=lens))
        except InputError as error:
            if isinstance(error, FormatError):
                raise
            raise FormatError(f"{where}: {error}") from error
    note = (
        f"the quaternions of {num_long} of {len(views)} pictures are far from the length 1: their directions are taken"
    )
    return Cameras(tuple(views), (note,) if num_long else ())


def _pose(numbers: tuple[float, ...], where: str) -> Array:
    q = np.array(numbers[:4])
    length = np.linalg.norm(q)
    if not (np.isfinite(numbers).all() and 1e-6 < length < 1e6):
        raise FormatError(
            f"{where}: found quaternion and translation {numbers}, wanted finite ones and a quaternion of length 1"
        )
    w, x, y, z = q / length
    pose = np.eye(4)
    pose[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    pose[:3, 3] = numbers[4:]
    return pose


class _Bytes:
    """A binary file, taken piece by piece; running over its end is an error."""

    def __init__(self, path: Path) -> None:
        self.path, self.data, self.at = path, path.read_bytes(), 0

    def take(self, layout: str) -> tuple[int | float, ...]:
        end = self.at + struct.calcsize(layout)
        if end > len(self.data):
            raise FormatError(f"{self.path}: found {len(self.data)} bytes, wanted at least {end}; the file is cut off")
        values = struct.unpack_from(layout, self.data, self.at)
        self.at = end
        return values

    def skip(self, num_bytes: int) -> None:
        self.at += num_bytes
        if self.at > len(self.data):
            raise FormatError(
                f"{self.path}: found {len(self.data)} bytes, wanted at least {self.at}; the file is cut off"
            )

    def name(self) -> str:
        end = self.data.find(b"\0", self.at)
        if end < 0:
            raise FormatError(f"{self.path}: found a name without an end at byte {self.at}; the file is cut off")
        name = _text(self.data[self.at : end])
        self.at = end + 1
        return name


def _cameras_bin(path: Path) -> _Lenses:
    file = _Bytes(path)
    found: _Lenses = {}
    (count,) = file.take("<Q")
    for _ in range(int(count)):
        number, model, width, height = (int(value) for value in file.take("<iiQQ"))
        where = f"{path}: camera {number}"
        if not 0 <= model < len(NUMBERED):
            raise FormatError(f"{where}: found model number {model}, wanted 0 to {len(NUMBERED) - 1}")
        name, num_parameters = NUMBERED[model]
        found[number] = name, file.take(f"<{num_parameters}d"), width, height, where
    return found


def _images_bin(path: Path) -> list[_Pose]:
    file = _Bytes(path)
    found: list[_Pose] = []
    (count,) = file.take("<Q")
    for _ in range(int(count)):
        _, *numbers, camera = file.take("<i7di")
        name = file.name()
        (num_points,) = file.take("<Q")
        file.skip(24 * int(num_points))  # x, y and the number of a point, 8 bytes each
        found.append((name, tuple(numbers), int(camera)))
    return found


def _cameras_txt(path: Path) -> _Lenses:
    found: _Lenses = {}
    for number, line in enumerate(_lines(path), start=1):
        if not line:
            continue
        where = f"{path}: line {number} (comments not counted)"
        try:
            camera, model, width, height, *parameters = line.split()
            found[int(camera)] = model, tuple(float(p) for p in parameters), int(width), int(height), where
        except ValueError as error:
            raise FormatError(f"{where}: found {line[:80]!r}, wanted CAMERA_ID MODEL WIDTH HEIGHT PARAMS…") from error
    return found


def _images_txt(path: Path) -> list[_Pose]:
    """Two lines a picture: the pose, then its points. Where there are none that line is blank, or was stripped by a tool."""
    found: list[_Pose] = []
    may_be_points = False
    for number, line in enumerate(_lines(path), start=1):
        if not line or (may_be_points and _are_points(line)):
            may_be_points = False
            continue
        try:
            _, *numbers, camera, name = line.split(maxsplit=9)
            if len(numbers) != 7:
                raise ValueError("too few numbers")
            found.append((name, tuple(float(v) for v in numbers), int(camera)))
        except ValueError as error:
            raise FormatError(
                f"{path}: line {number} (comments not counted): found {line[:80]!r}, wanted "
                "IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME"
            ) from error
        may_be_points = True
    return found


def _are_points(line: str) -> bool:
    """Whether a line is x, y and the number of a point, again and again; a pose has ten words, of which one is a name."""
    words = line.split()
    if len(words) % 3:
        return False
    try:
        return all(math.isfinite(float(word)) for word in words)
    except ValueError:
        return False


def _lines(path: Path) -> list[str]:
    """Lines that are no comments; bytes that are no UTF-8 are Latin-1, as older tools write names."""
    data = path.read_bytes()
    if b"\0" in data:
        raise FormatError(f"{path}: not text, it holds zero bytes; the file is damaged or of another kind")
    return [line.strip() for line in _text(data).split("\n") if not line.lstrip().startswith("#")]


def _text(data: bytes) -> str:
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("latin-1")
