"""Photographs of views: found once (`splatree.io.photo_paths`), read when they are asked for, at the size of a view.

A photograph smaller than its camera's picture makes the view smaller; a larger one is averaged down to the view. A photograph
through a lens is straightened to the largest upright rectangle that it fills, and the view becomes that pinhole.
"""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from splatree.errors import InputError
from splatree.io.images import image_size, read_image, read_opacity, read_pixels
from splatree.io.photo_paths import find_photos
from splatree.io.photo_search import fits_shape
from splatree.scene.cameras import Camera
from splatree.scene.warp import filled_pinhole, straighten
from splatree.shapes import Array, Bool, UInt8

__all__ = ["Photos", "PhotosUsed"]

_SHOWN = 8


@dataclass(frozen=True)
class PhotosUsed:
    """Which photographs pictures are compared with."""

    folders: dict[str, int]
    """Folders, relative to the one that was named, and how many photographs each has."""
    found: int
    """Cameras with a photograph."""
    missing: tuple[str, ...]
    """Names of the cameras without one."""
    notes: tuple[str, ...]
    """What was done to fit photographs and cameras to each other, a sentence each."""

    def in_words(self) -> list[str]:
        """A line for each thing that the user should know."""
        places = ", ".join(f"{count} in {folder}/" for folder, count in self.folders.items())
        lines = [f"photographs: {places.replace(' ./', ' the folder itself')}"]
        if self.missing:
            names = ", ".join(self.missing[:_SHOWN]) + (", ..." if len(self.missing) > _SHOWN else "")
            lines.append(f"no photograph of {len(self.missing)} of {self.found + len(self.missing)} cameras: {names}")
        return [*lines, *(f"note: {note}" for note in self.notes)]


class Photos(Mapping[str, Array]):
    """Photographs in a folder, float32 (h w 3), by the camera's name; views without one are left out.

    ``views`` are all cameras as they are to be drawn and compared: pinholes, at most as large as their photographs.

    Raises:
        InputError: as `find_photos`.
    """

    def __init__(self, folder: Path, cameras: Sequence[Camera]) -> None:
        found = find_photos(folder, cameras)
        self._paths, self._turned = dict(found.paths), found.turned
        self._taken: dict[str, Camera] = {}  # the camera of each photograph, lens and all, at the size it is read at
        notes: Counter[str] = Counter()
        for camera in cameras:
            size = found.sizes.get(camera.name, (camera.width, camera.height))
            before = f"{camera.width} × {camera.height} px"
            if size[0] * size[1] < camera.width * camera.height:
                camera = camera.resized(*size)
                notes[f"drawn at the size of the photographs, {size[0]} × {size[1]} px; the cameras say {before}"] += 1
            elif size != (camera.width, camera.height):
                notes[f"averaged from {size[0]} × {size[1]} px to the size of the cameras, {before}"] += 1
            self._taken[camera.name] = camera
        flat = {name: filled_pinhole(camera) if camera.lens else camera for name, camera in self._taken.items()}
        for name, view in flat.items():
            if self._taken[name].lens is not None:
                notes[f"straightened by the lens of their cameras, to {view.width} × {view.height} px"] += 1
        self._views = flat
        if found.turned:
            notes["turned as their EXIF orientation says, as their cameras saw them"] = len(found.turned)
        if found.not_turned:
            notes["taken as stored, though they have an EXIF orientation: COLMAP and 3DGS do not turn them"] = (
                found.not_turned
            )
        self.used = PhotosUsed(
            dict(found.folders),
            len(self._paths),
            found.missing,
            tuple(f"{count} of {len(cameras)} views: {note}" for note, count in notes.items()),
        )

    @property
    def views(self) -> tuple[Camera, ...]:
        """All cameras as they are to be drawn, in their order."""
        return tuple(self._views.values())

    def at(self, cameras: Sequence[Camera]) -> "Photos":
        """The same photographs for some of the views, at the sizes of ``cameras``."""
        fewer = object.__new__(Photos)
        fewer._taken, fewer._turned, fewer.used = self._taken, self._turned, self.used
        fewer._views = {camera.name: camera for camera in cameras}
        fewer._paths = {camera.name: self._paths[camera.name] for camera in cameras if camera.name in self._paths}
        return fewer

    def __getitem__(self, name: str) -> Array:
        if name not in self._paths:
            raise KeyError(name)
        view, taken = self._views[name], self._read_as(name)
        photo = read_image(self._paths[name], size=(taken.width, taken.height), turned=name in self._turned)
        return photo if taken.lens is None else straighten(photo, taken, view)

    def __contains__(self, name: object) -> bool:
        """Whether a view has a photograph; a `Mapping` would read it to say so."""
        return name in self._paths

    def path_of(self, name: str) -> Path:
        """The file of a photograph."""
        return self._paths[name]

    def pixels(self, name: str) -> UInt8[Array, "h w 3"]:
        """A photograph with 8 bits a channel, as it is stored unless a lens was straightened."""
        view, taken = self._views[name], self._read_as(name)
        photo = read_pixels(self._paths[name], size=(taken.width, taken.height), turned=name in self._turned)
        if taken.lens is None:
            return photo
        return np.rint(straighten(photo.astype(np.float32), taken, view)).astype(np.uint8)

    def opacity(self, name: str) -> UInt8[Array, "h w"] | None:
        """The alpha channel of a photograph, 0 to 255; None if it has none."""
        view, taken = self._views[name], self._read_as(name)
        plane = read_opacity(self._paths[name], size=(taken.width, taken.height), turned=name in self._turned)
        if plane is None or taken.lens is None:
            return plane
        return np.rint(straighten(plane.astype(np.float32), taken, view)).astype(np.uint8)

    def counting(self, name: str, mask: Path | None = None, *, alpha: bool = True) -> Bool[Array, "h w"] | None:
        """Pixels that count: opaque in the photograph, if ``alpha`` says so, and lighter than half in ``mask``; None: all."""
        view, taken = self._views[name], self._read_as(name)
        size = (taken.width, taken.height)
        opacity = read_opacity(self._paths[name], size=size, turned=name in self._turned) if alpha else None
        planes = [] if opacity is None else [opacity > 254]
        if mask is not None:
            planes.append(read_pixels(mask, size=size).min(axis=2) > 127)
        if not planes:
            return None
        counts = np.logical_and.reduce(planes)
        if taken.lens is not None:
            counts = straighten(counts.astype(np.float32), taken, view) > 0.999
        return None if counts.all() else counts

    def check_mask(self, name: str, mask: Path) -> None:
        """Refuse a mask of another shape than its photograph.

        Raises:
            InputError: it is.
            FormatError: it is no picture.
        """
        size, taken = image_size(mask), self._taken[name]
        if not fits_shape(size, (taken.width, taken.height)):
            raise InputError(
                f"masks: {mask}: found {size[0]} × {size[1]} px, which is not the shape of its photograph {name!r}, "
                f"{taken.width} × {taken.height} px; wanted it as the photograph was taken, neither turned nor cropped"
            )

    def _read_as(self, name: str) -> Camera:
        """The camera of a photograph, lens and all, at the size at which it is read for its view."""
        view, taken = self._views[name], self._taken[name]
        if taken.lens is None:
            return view
        return taken.scaled(view.width / filled_pinhole(taken).width)

    def __iter__(self) -> Iterator[str]:
        return iter(self._paths)

    def __len__(self) -> int:
        return len(self._paths)


def photographed(cameras: Sequence[Camera], photos: Photos, what: str) -> None:
    """Refuse views of which none has a photograph.

    Raises:
        InputError: there are views and none has one.
    """
    if cameras and not any(camera.name in photos for camera in cameras):
        raise InputError(
            f"data: none of the {len(cameras)} {what} has a photograph ({cameras[0].name!r}, ...), "
            f"though {photos.used.found} other views have; wanted photographs of these, or other views: "
            "--held-out 4 holds out every fourth, --held-out FILE those that a file names"
        )
