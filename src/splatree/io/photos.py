"""Photographs of views: found by the camera's name, read when they are asked for, at the camera's size."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from splatree.errors import InputError
from splatree.io.images import read_image
from splatree.scene.cameras import Camera
from splatree.shapes import Array

__all__ = ["Photos"]

SUFFIXES = (".png", ".jpg", ".jpeg", ".webp")


class Photos(Mapping[str, Array]):
    """Photographs in a folder or below it, float32 (h w 3), by the camera's name; views without one are left out.

    Raises:
        InputError: the folder is none, or no picture in it is named like a camera.
    """

    def __init__(self, folder: Path, cameras: Sequence[Camera]) -> None:
        if not folder.is_dir():
            raise InputError(f"data: {folder} is not a folder; wanted the folder of the photographs")
        self._cameras = {camera.name: camera for camera in cameras}
        files = [path for path in sorted(folder.rglob("*")) if path.suffix.lower() in SUFFIXES]
        by_name = {path.relative_to(folder).as_posix(): path for path in files}
        by_stem = {path.stem: path for path in files}
        self._paths = {
            name: path
            for name in self._cameras
            if (path := by_name.get(name) or by_stem.get(Path(name).stem)) is not None
        }
        if not self._paths:
            first = cameras[0].name if cameras else ""
            raise InputError(
                f"data: none of the {len(files)} pictures in {folder} is named like a camera ({first!r}, ...)"
            )

    def __getitem__(self, name: str) -> Array:
        camera = self._cameras[name]
        return read_image(self._paths[name], size=(camera.width, camera.height))

    def __iter__(self) -> Iterator[str]:
        return iter(self._paths)

    def __len__(self) -> int:
        return len(self._paths)
