"""Cameras of a scene from the files that training and reconstruction leave: INRIA, COLMAP, nerfstudio.

All become world-to-camera poses with OpenCV axes (x right, y down, z forward), intrinsics, and a lens where the file names one.
"""

import json
import os
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from splatree.constants import NEAR
from splatree.errors import FormatError, InputError
from splatree.io import untrusted
from splatree.io.cameras import camera_path, colmap, foreign, llff, nerfstudio
from splatree.io.cameras.poses import Rotations
from splatree.io.replacing import replacing
from splatree.scene.arguments import checked
from splatree.scene.cameras import Camera, Cameras, check_is_camera
from splatree.scene.scene import Source

_SPLITS = ("transforms_train.json", "transforms_val.json", "transforms_test.json")
"""Files of synthetic scenes (Mildenhall 2020), a part of the views each."""

COLMAP_FOLDERS = ("sparse", "colmap/sparse", "")
"""Where a model or several numbered ones lie in a folder of pictures, in the order in which they are tried."""


@checked
def read_cameras(path: str | os.PathLike[str], *, source: Source | None = None) -> Cameras:
    """Read the views of a file or folder.

    - ``cameras.json`` of a 3DGS training. Its rotation is camera-to-world, its position the centre. Views are in the order of the
      file.
    - A COLMAP sparse model, binary or text, or a folder with one in ``sparse/0``. Views are in the order of the pictures' names,
      because the 3DGS code holds out every eighth of them for tests in that order.
    - ``transforms.json`` of nerfstudio or instant-ngp, with the axes of OpenGL. Views are in the order of the file.

    A folder is searched for a COLMAP model, then transforms.json, then cameras.json.

    Args:
        path: the file or folder.
        source: ``source`` of the scene that is looked at; poses are given in its coordinates, and views that say nothing of
            ``near`` begin where its training began. None: as in the file.

    Returns:
        The views, with OpenCV axes and intrinsics in px.

    Raises:
        FormatError: the file is damaged or holds no camera, or a camera has a lens of an unknown model.
        InputError: there is nothing of these kinds.

    Example:
        >>> len(st.read_cameras("cameras.json"))
        10
    """
    cameras = _read(Path(path))
    if not len(cameras):
        raise FormatError(f"{path}: found no camera in it, wanted at least one")
    return cameras if source is None else cameras.relative_to(source)


def _read(root: Path) -> Cameras:
    if root.is_dir():
        for folder in COLMAP_FOLDERS:
            if models := colmap.models_in(root / folder):
                return nerfstudio.in_training_frame(_largest_model(models), root)
        if (root / "transforms.json").is_file():
            return _read(root / "transforms.json")
        if splits := [root / name for name in _SPLITS if (root / name).is_file()]:
            return _of_splits(splits)
        for name in ("cameras.json", llff.NAME, "camera_path.json"):
            if (root / name).is_file():
                return _read(root / name)
        if known := foreign.advice_for_file(root):
            raise InputError(f"{root}: {known}")
        halves = [half for folder in COLMAP_FOLDERS if (half := colmap.half_model_in(root / folder))]
        if halves:
            raise InputError(f"{root}: found {halves[0]}, wanted both, which make a COLMAP model")
        raise InputError(
            f"{root}: found no cameras in this folder; wanted a COLMAP model (cameras.bin and images.bin, or .txt) in it or in "
            "sparse/0, transforms.json, cameras.json, poses_bounds.npy or camera_path.json"
        )
    if not root.is_file():
        raise InputError(f"{root}: not found; wanted cameras.json, transforms.json or a folder with a COLMAP model")
    if known := foreign.advice_for_file(root):
        raise InputError(f"{root}: {known}")
    if root.suffix.lower() == ".npy":
        return llff.read(root)
    if root.suffix.lower() in (".bin", ".txt"):
        if colmap.is_model(root.parent):
            return colmap.read(root.parent)
        raise InputError(f"{root}: found no COLMAP model in its folder, wanted cameras and images beside each other")
    if root.suffix.lower() != ".json" and not _is_text(root):
        raise InputError(
            f"{root}: found a file that is no text; wanted cameras.json, transforms.json, or a folder with a COLMAP model"
        )
    content = untrusted.read_json(root)
    if known := foreign.advice_for_content(content):
        raise InputError(f"{root}: {known}")
    if isinstance(content, dict) and "frames" in content:
        return nerfstudio.parse(content, root)
    if isinstance(content, dict) and "camera_path" in content:
        return camera_path.parse(content, root)
    if root.name == nerfstudio.DATAPARSER:
        raise InputError(
            f"{root}: holds no cameras; it is taken along where it lies beside transforms.json: name that, or the folder"
        )
    if isinstance(content, list):
        return _parse_inria(content, root)
    raise FormatError(
        f"{root}: found other JSON, wanted a list of cameras (INRIA), or an object with frames or a camera_path (nerfstudio)"
    )


def _is_text(path: Path) -> bool:
    with path.open("rb") as file:
        return b"\0" not in file.read(4096)


def _of_splits(paths: Sequence[Path]) -> Cameras:
    """The cameras of several files, one after the other."""
    parts = [_read(path) for path in paths]
    notes = dict.fromkeys(note for part in parts for note in part.notes)
    counts = ", ".join(f"{len(part)} of {path.name}" for path, part in zip(paths, parts, strict=True))
    note = f"cameras: {counts}; to score the views of one file, name it: --held-out {paths[-1].name}"
    return Cameras(tuple(view for part in parts for view in part), (*notes, note))


def _largest_model(models: Sequence[Path]) -> Cameras:
    """The first of several models of one folder; COLMAP numbers the pieces that it could not join."""
    cameras = colmap.read(models[0])
    if len(models) == 1:
        return cameras
    counts = ", ".join(f"{model.name}: {colmap.num_pictures(model)}" for model in models)
    note = (
        f"{models[0].parent} holds {len(models)} COLMAP models (pictures by number: {counts}); the one with most pictures, "
        f"{models[0].name}, is taken; name the folder of another to take that"
    )
    return replace(cameras, notes=(*cameras.notes, note))


@checked
def write_cameras(cameras: Iterable[Camera], path: str | os.PathLike[str], *, force: bool = False) -> None:
    """Write views as the JSON of the 3DGS code.

    ``cx cy`` are added if the principal point is not the middle, ``near`` if it is not the default.

    Args:
        cameras: the views.
        path: the new file, .json.
        force: replace the file if it exists.

    Raises:
        InputError: there is no camera, or one has a lens, which the file cannot hold.
        OutputError: the file exists and ``force`` is not set, or it cannot be written.

    Example:
        >>> st.write_cameras(cameras, "views.json", force=True)
        >>> len(st.read_cameras("views.json")) == len(cameras)
        True
    """
    views = [] if isinstance(cameras, Camera) else list(cameras)
    if not views:
        raise InputError(
            f"{path}: found {'one' if isinstance(cameras, Camera) else 'no'} Camera, wanted a list with some"
        )
    records = []
    for i, camera in enumerate(views):
        check_is_camera(camera)
        if camera.lens is not None:
            raise InputError(
                f"{path}: camera {camera.name!r} has a lens, which cameras.json cannot hold; wanted pinholes"
            )
        record = {
            "id": i,
            "img_name": camera.name,
            "width": camera.width,
            "height": camera.height,
            "position": camera.position.tolist(),
            "rotation": camera.camera_from_world[:3, :3].T.tolist(),
            "fy": float(camera.K[1, 1]),
            "fx": float(camera.K[0, 0]),
        }
        if (camera.K[0, 2], camera.K[1, 2]) != (camera.width / 2, camera.height / 2):
            record |= {"cx": float(camera.K[0, 2]), "cy": float(camera.K[1, 2])}
        if camera.near != NEAR:
            record["near"] = camera.near
        records.append(record)
    with replacing(path, force=force) as temporary:
        temporary.write_text(json.dumps(records, indent=1) + "\n", encoding="utf-8")


@np.errstate(over="ignore", invalid="ignore")  # absurd numbers become infinite, which Camera refuses
def _parse_inria(records: list[object], path: Path) -> Cameras:
    views, rotations = [], Rotations()
    for i, value in enumerate(records):
        where = f"{path}: camera {i}"
        record = untrusted.as_object(value, where)
        width, height = (untrusted.integer(record, key, where, low=1) for key in ("width", "height"))
        rotation = rotations.of(untrusted.numbers(record, "rotation", where, (3, 3)), where).T
        pose = np.eye(4)
        pose[:3, :3] = rotation
        pose[:3, 3] = -rotation @ untrusted.numbers(record, "position", where, (3,))
        fx, fy = untrusted.number(record, "fx", where), untrusted.number(record, "fy", where)
        cx = untrusted.number(record, "cx", where) if "cx" in record else width / 2
        cy = untrusted.number(record, "cy", where) if "cy" in record else height / 2
        near = untrusted.number(record, "near", where) if "near" in record else NEAR
        name = untrusted.text(record, "img_name", where) if "img_name" in record else ""
        K = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
        try:
            views.append(Camera(pose, K, width, height, near, name))
        except InputError as error:
            raise FormatError(f"{where}: {error}") from error
    return Cameras(tuple(views), rotations.notes)
