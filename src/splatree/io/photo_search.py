"""Look for the photographs of names in one folder; `splatree.io.photo_paths` says by which rules."""

import os
import posixpath
import unicodedata
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from splatree.errors import InputError
from splatree.io.images import image_head

__all__ = ["SUFFIXES", "NoPhotosError", "PhotoSearch", "Size", "fits_shape", "relative_name"]

SUFFIXES = (".png", ".jpg", ".jpeg", ".webp", ".tif", ".tiff", ".bmp")
"""Ends of the names of pictures."""

_OTHER_PICTURES = ("mask", "depth", "normal", "thumb", "alpha", "segment", "semantic", "render", "@eadir", "__macosx")
"""Beginnings of names of folders whose pictures are not photographs; they are not searched unless they are named."""

_PLAIN_FOLDERS = (
    "images",
    "image",
    "img",
    "imgs",
    "rgb",
    "color",
    "colour",
    "input",
    "frames",
    "photos",
    "undistorted",
)
"""Folders of names that may go by another name on the disk, scaled copies of them included."""

_SPLITS = ("train", "val", "test", "eval", "validation", "left", "right")
"""Folders whose pictures are others than those of the same name beside them."""

_SHOWN = 5
"""How many names an error lists."""

_Parts = tuple[str, ...]
Size = tuple[int, int]
"""Width and height, px."""


def fits_shape(size: Size, camera: Size) -> bool:
    """Whether a picture is the camera's picture at another scale, to within one pixel along each side."""
    low = max((size[i] - 1) / camera[i] for i in (0, 1))
    high = min((size[i] + 1) / camera[i] for i in (0, 1))
    return low < high


@dataclass(frozen=True)
class _Place:
    """Where names are looked up."""

    base: Path
    strip: int  # folders that names lose


class NoPhotosError(InputError):
    """None of the cameras has a photograph."""


class PhotoSearch:
    """Looks for the photographs of names in one folder; what was listed is kept for the next name."""

    def __init__(self, folder: Path, names: Sequence[str]) -> None:
        self.folder = folder
        self.parts = {name: _parts(name) for name in names}
        self.is_absolute = any(name.replace("\\", "/").startswith("/") or name[1:2] == ":" for name in names)
        self.own = folder.absolute().parts
        self._listings: dict[Path, dict[str, list[Path]]] = {}
        self._heads: dict[Path, tuple[Size, int]] = {}

    def in_known_places(self, wanted: Mapping[str, Size]) -> dict[str, Path]:
        """The photographs of the place that fits best; none if no place has any."""
        found: list[tuple[tuple[int, int, int], dict[str, Path]]] = []
        for place in self._places():
            paths = self._in_place(place)
            if paths:
                sizes = {name: self.size_of(path) for name, path in paths.items()}
                exact = sum(sizes[name] == wanted[name] for name in paths)
                shaped = sum(fits_shape(sizes[name], wanted[name]) for name in paths)
                found.append(((exact, shaped, len(paths)), paths))
        if not found:
            return {}
        top = max(key for key, _ in found)
        first, *others = [paths for key, paths in found if key == top]
        for other in others if top[0] else ():  # of copies at other scales the first is the largest
            for name in first:
                if name in other and not _are_same(first[name], other[name]):
                    raise _ambiguous(name, [first[name], other[name]], self.folder)
        return first

    def anywhere_below(self, wanted: Mapping[str, Size]) -> dict[str, Path]:
        """Photographs below the folder whose last folders and name are a camera's."""
        paths = {}
        for name, words in self.parts.items():
            found = [path for base in _folders_below(self.folder) for path in self._files_named(base, words)]
            if len(found) > 1:
                found = self._most_fitting(found, wanted[name])
            if len(found) > 1:
                raise _ambiguous(name, found, self.folder)
            if found:
                paths[name] = found[0]
        return paths

    def size_of(self, path: Path) -> Size:
        """Width and height of a picture as it is stored, px."""
        return self.head_of(path)[0]

    def head_of(self, path: Path) -> tuple[Size, int]:
        """Size and EXIF orientation of a picture."""
        if path not in self._heads:
            self._heads[path] = image_head(path)
        return self._heads[path]

    def nothing_found(self) -> NoPhotosError:
        """The error that says which files have the names in places that do not count."""
        names = list(self.parts)
        bases = _folders_below(self.folder)
        num_pictures = sum(len(files) for base in bases for files in self._listing(base).values())
        last = [words[-1:] for words in self.parts.values() if words][:_SHOWN]
        walked = [Path(place) for place, _, _ in os.walk(self.folder)]
        others = [place for place in walked if any(self._files_named(place, words) for words in last)]
        hint = ""
        if others:
            listed = ", ".join(relative_name(other, self.folder) for other in others[:_SHOWN])
            hint = (
                f"; files of these names lie in {listed}, but the cameras name other folders or these hold no photographs by "
                "their names: if they are meant, name that folder with --data"
            )
        cameras = f"the {len(names)} cameras ({names[0] if names else ''!r}, ...)"
        if not num_pictures:
            return NoPhotosError(f"data: found no pictures in {self.folder}, wanted those of {cameras}{hint}")
        return NoPhotosError(
            f"data: none of the {num_pictures} pictures in {self.folder} is named like one of {cameras}{hint}"
        )

    def _in_place(self, place: _Place) -> dict[str, Path]:
        paths = {}
        for name, words in self.parts.items():
            if len(words) > place.strip and self._may_lose(words, place.strip):
                found = self._files_named(place.base, words[place.strip :])
                if len(found) > 1:
                    raise _ambiguous(name, found, self.folder)
                if found:
                    paths[name] = found[0]
        return paths

    def _places(self) -> list[_Place]:
        strips = range(max(map(len, self.parts.values()), default=1))
        places = [_Place(base, strip) for strip in strips for base in (self.folder, self.folder / "images")]
        copies = []
        for place in places:
            heads = {words[place.strip] for words in self.parts.values() if len(words) > place.strip + 1}
            if place.base != self.folder:
                copies += [_Place(copy, place.strip) for copy in _scaled_copies(place.base)]
            elif len(heads) == 1:
                copies += [_Place(copy, place.strip + 1) for copy in _scaled_copies(self.folder / heads.pop())]
        return list(dict.fromkeys(places + copies))

    def _may_lose(self, words: _Parts, strip: int) -> bool:
        """Whether a name may lose its first folders: those of the folder itself, or plain ones that all names share."""
        if strip == 0 or words[:strip] == self.own[-strip:]:
            return True
        if any(other[:strip] != words[:strip] for other in self.parts.values()):
            return False
        innermost = words[strip - 1].lower()
        if self.is_absolute:
            return innermost not in _SPLITS
        return innermost.rstrip("0123456789").rstrip("_") in _PLAIN_FOLDERS

    def _most_fitting(self, found: list[Path], wanted: Size) -> list[Path]:
        """Those of the camera's size, else those of its shape; of scaled copies of one folder the largest."""
        exact = [path for path in found if self.size_of(path) == wanted]
        fitting = exact or [path for path in found if fits_shape(self.size_of(path), wanted)] or found
        families = {(path.parent.parent, path.parent.name.rstrip("0123456789").rstrip("_")) for path in fitting}
        return [max(fitting, key=self.size_of)] if len(families) == 1 and not exact else fitting

    def _files_named(self, base: Path, words: _Parts) -> list[Path]:
        """The file itself, or else those of its folder with its stem and the suffix of a picture."""
        path = base.joinpath(*words)
        is_named = path.suffix.lower() in SUFFIXES
        if is_named and _is_file(path):
            return [path]
        stem = path.stem if is_named else path.name
        found = self._listing(path.parent).get(_key(stem), [])
        found = [other for other in found if other.stem == stem] or found
        return [other for other in found if other.suffix.lower() == path.suffix.lower()] or found

    def _listing(self, folder: Path) -> dict[str, list[Path]]:
        """Picture files of a folder by their stems, in which neither case nor coding of letters matters."""
        if folder not in self._listings:
            files: dict[str, list[Path]] = {}
            try:
                entries = sorted(os.scandir(folder), key=lambda entry: entry.name)
            except OSError:  # no folder, or none that may be read
                entries = []
            for entry in entries:
                stem, suffix = Path(entry.name).stem, Path(entry.name).suffix
                if suffix.lower() in SUFFIXES and not entry.name.startswith(".") and entry.is_file():
                    files.setdefault(_key(stem), []).append(folder / entry.name)
            self._listings[folder] = files
        return self._listings[folder]


def _parts(name: str) -> _Parts:
    """Folders and name, without ``.``, drive and root; ``..`` is resolved as far as it goes."""
    parts = PurePosixPath(posixpath.normpath(name.replace("\\", "/"))).parts
    return tuple(part for part in parts if part not in ("/", "//", ".") and not part.endswith(":"))


def _key(stem: str) -> str:
    """A name in lower case, in one normal form, from UTF-8 or Latin-1."""
    data = os.fsencode(stem)
    try:
        text = data.decode("utf-8")
    except UnicodeDecodeError:
        text = data.decode("latin-1")
    return unicodedata.normalize("NFC", text).casefold()


def _scaled_copies(base: Path) -> list[Path]:
    """Folders beside ``base`` named like it with _2, _4, … behind, the largest pictures first."""
    prefix = f"{base.name}_"
    if not base.parent.is_dir():
        return []
    found = [child for child in base.parent.iterdir() if child.name.startswith(prefix) and child.is_dir()]
    numbered = [(int(child.name[len(prefix) :]), child) for child in found if child.name[len(prefix) :].isdecimal()]
    return [child for _, child in sorted(numbered)]


def _folders_below(folder: Path) -> list[Path]:
    """The folders that may hold photographs, links followed, each once."""
    seen, found = set(), []
    for place, names, _ in os.walk(folder, followlinks=True):
        real = os.path.realpath(place)
        if real in seen:
            names.clear()
            continue
        seen.add(real)
        found.append(Path(place))
        names[:] = sorted(n for n in names if not n.startswith(".") and not n.lower().startswith(_OTHER_PICTURES))
    return found


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except (OSError, ValueError):  # a name that is too long or holds a zero, or a loop of links
        return False


def _are_same(one: Path, other: Path) -> bool:
    return one.samefile(other) or (
        one.stat().st_size == other.stat().st_size and one.read_bytes() == other.read_bytes()
    )


def _ambiguous(name: str, found: Sequence[Path], folder: Path) -> InputError:
    listed = ", ".join(str(path.relative_to(folder)) for path in found[:_SHOWN])
    return InputError(
        f"data: the photograph of camera {name!r} could be any of {len(found)} files in {folder}: {listed}; name the folder of "
        "the photographs itself (and the cameras with --cameras)"
    )


def relative_name(path: Path, folder: Path) -> str:
    try:
        return path.relative_to(folder).as_posix()
    except ValueError:
        return str(path)
