"""Views of LLFF's ``poses_bounds.npy``: a row of 17 numbers for each picture of the folder ``images``, in the order of names.

A row is a matrix 3 × 5, row by row, and the nearest and farthest depth. The matrix is camera-to-world with the axes down, right,
back; its last column is height, width and focal length in px. github.com/Fyusion/LLFF, "Using your own poses without COLMAP".
"""

from pathlib import Path

import numpy as np

from splatree.errors import FormatError, InputError
from splatree.io.photo_search import SUFFIXES
from splatree.scene.cameras import Camera, Cameras
from splatree.shapes import Array

__all__ = ["NAME", "read"]

NAME = "poses_bounds.npy"

_BYTES_MAX = 1 << 27


def read(path: Path) -> Cameras:
    """Read all views, named by the pictures beside the file if there are as many."""
    if path.stat().st_size > _BYTES_MAX:
        raise FormatError(f"{path}: found {path.stat().st_size} bytes, wanted at most {_BYTES_MAX}")
    try:
        rows = np.load(path, allow_pickle=False)
    except (ValueError, EOFError, OSError) as error:
        raise FormatError(f"{path}: no array of numbers ({error}); the file is damaged") from error
    if rows.ndim != 2 or rows.shape[1] != 17 or rows.dtype.kind not in "fiu":
        raise FormatError(f"{path}: found {rows.dtype} of shape {rows.shape}, wanted numbers of shape (views, 17)")
    if not np.isfinite(rows).all():
        raise FormatError(f"{path}: found NaN or infinity, wanted finite numbers")
    names, note = _names(path.parent / "images", len(rows))
    numbered = enumerate(zip(rows.astype(np.float64), names, strict=True))
    return Cameras(tuple(_view(row, name, f"{path}: row {i}") for i, (row, name) in numbered), note)


def _names(folder: Path, count: int) -> tuple[list[str], tuple[str, ...]]:
    """The pictures in the order of their names; numbers if there are not as many."""
    found = sorted(path.name for path in folder.iterdir() if path.suffix.lower() in SUFFIXES) if folder.is_dir() else []
    if len(found) == count:
        return found, ()
    note = f"{NAME} has {count} views and {folder} {len(found)} pictures: views are named by their numbers"
    return [f"view_{i:04d}" for i in range(count)], (note,) if found else ()


def _view(row: Array, name: str, where: str) -> Camera:
    matrix = row[:15].reshape(3, 5)
    height, width, focal = (float(x) for x in matrix[:, 4])
    if not (height >= 1 and width >= 1 and height < 2**31 and width < 2**31):
        raise FormatError(f"{where}: found the size {width:g} × {height:g}, wanted at least 1 × 1 px")
    down, right, back = matrix[:, :3].T
    pose = np.eye(4)
    pose[:3, :3] = np.stack([right, down, -back])
    pose[:3, 3] = -pose[:3, :3] @ matrix[:, 3]
    size = round(width), round(height)
    K = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])
    try:
        return Camera(pose, K, *size, name=name)
    except InputError as error:
        raise FormatError(f"{where}: {error}") from error
