"""Which photograph belongs to which camera, by the camera's name: one folder for all cameras, or an error that says why not.

A camera's name is a path: ``file_path`` of a JSON relative to its folder, a COLMAP name relative to ``images``, or a bare stem.
It is looked up, after ``./`` and ``\\`` are normalised, in these places of the folder that was named:

1. the folder itself, and its ``images``; also without the folders that names begin with, where these are the last ones of the
   folder itself, or plain ones (``images``, the start of an absolute path) that all names share;
2. scaled copies beside these: ``images_2``, ``images_4``, ``images_8``;
3. if none of them has any of the names: anywhere below, but for folders that hold masks, depths, thumbnails and the like.

Of 1 and 2 the place is taken in which most photographs have exactly the cameras' sizes, then the one in which most have their
shape, then the first. Links are followed. A name alone never matches across different subfolders: ``left/0000`` is not
``right/0000``. What stays ambiguous is refused.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from splatree.errors import InputError
from splatree.io.photo_search import PhotoSearch, Size, fits_shape, relative_name
from splatree.scene.cameras import Camera

__all__ = ["FoundPhotos", "find_photos"]

_SWAPS_SIDES = 5
"""EXIF orientations from this on exchange width and height."""


@dataclass(frozen=True)
class FoundPhotos:
    """Photographs of cameras."""

    paths: Mapping[str, Path]
    """File by the camera's name."""
    sizes: Mapping[str, Size]
    """Width and height in px of each, turned where it is turned."""
    turned: frozenset[str]
    """Names of the cameras whose photographs are to be turned as their EXIF orientation says."""
    not_turned: int
    """Photographs with an EXIF orientation that are taken as they are stored."""
    missing: tuple[str, ...]
    """Names of the cameras without one."""
    folders: Mapping[str, int]
    """Folders, relative to the one that was named, and how many photographs each has."""


def find_photos(folder: Path, cameras: Sequence[Camera]) -> FoundPhotos:
    """Find the photographs of ``cameras`` in a folder.

    Raises:
        InputError: the folder is none; two cameras have one name; no photograph is found, or several for a camera; or one has
            another shape than its camera.
    """
    if not folder.is_dir():
        raise InputError(f"data: {folder} is not a folder; wanted the folder of the photographs")
    twice = [name for name, count in Counter(camera.name for camera in cameras).items() if count > 1 or not name]
    if twice:
        raise InputError(
            f"data: found several cameras named {twice[0]!r}, or one without a name: their photographs cannot be told apart; "
            "wanted names with folders, as COLMAP and nerfstudio write them"
        )
    wanted = {camera.name: (camera.width, camera.height) for camera in cameras}
    search = PhotoSearch(folder, list(wanted))
    paths = search.in_known_places(wanted) or search.anywhere_below(wanted)
    if not paths:
        raise search.nothing_found()
    turned, not_turned = _to_turn({name: search.head_of(path) for name, path in paths.items()}, wanted)
    sizes = {name: search.size_of(path) for name, path in paths.items()}
    sizes |= {name: sizes[name][::-1] for name in turned if search.head_of(paths[name])[1] >= _SWAPS_SIDES}
    _check_shapes(paths, sizes, wanted)
    _check_own(paths)
    places = Counter(relative_name(path.parent, folder) for path in paths.values())
    return FoundPhotos(
        paths, sizes, turned, not_turned, tuple(name for name in wanted if name not in paths), dict(places)
    )


def _to_turn(heads: Mapping[str, tuple[Size, int]], wanted: Mapping[str, Size]) -> tuple[frozenset[str], int]:
    """Which photographs the maker of the cameras saw turned as EXIF says; and how many that have an orientation it did not.

    A photograph that fits its camera only when it is turned was seen so. One that fits only as stored was not: COLMAP turns none.
    The shape of others says nothing (half a turn, a mirror, a square): they follow the rest if that is of one mind, and are else
    taken as stored.
    """
    tagged = {name: head for name, head in heads.items() if head[1] != 1}
    swapped = {name: size for name, (size, orientation) in tagged.items() if orientation >= _SWAPS_SIDES}
    as_stored = {name for name, size in swapped.items() if fits_shape(size, wanted[name])}
    as_turned = {name for name, size in swapped.items() if fits_shape(size[::-1], wanted[name])}
    turned = as_turned - as_stored
    if turned and not as_stored - as_turned:
        turned = as_turned | (tagged.keys() - swapped.keys())
    return frozenset(turned), len(tagged) - len(turned)


def _check_shapes(paths: Mapping[str, Path], sizes: Mapping[str, Size], wanted: Mapping[str, Size]) -> None:
    wrong = [name for name in paths if not fits_shape(sizes[name], wanted[name])]
    if wrong:
        name = wrong[0]
        raise InputError(
            f"data: {paths[name]}: found {sizes[name][0]} × {sizes[name][1]} px, which is not the shape of its camera "
            f"{name!r}, {wanted[name][0]} × {wanted[name][1]} px; {len(wrong)} of {len(paths)} photographs do not fit: "
            "wanted the pictures that the cameras were made from, neither turned nor cropped, and no masks"
        )


def _check_own(paths: Mapping[str, Path]) -> None:
    """No photograph is that of two cameras."""
    owners: dict[Path, str] = {}
    for name, path in paths.items():
        if path in owners:
            raise InputError(
                f"data: {path} would be the photograph of both {owners[path]!r} and {name!r}; wanted one for each camera: "
                "name the folder in which the names of the cameras begin"
            )
        owners[path] = name
