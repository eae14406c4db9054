"""Inputs that are not files of their own: addresses, standard input, and compressed files of one scene.

Objects of stores, ``s3://…``, are read where they lie (`splatree.io.objects`), and so are folders that an address of https names.
Other inputs are brought into a temporary folder under their own names, and that is read like any other file:

- one file of ``https://…`` and ``http://…``, by the standard library, whether or not the server gives ranges;
- ``-``, standard input, which has to be a .ply or an .spz;
- ``a.ply.gz``, and a ``.zip`` that holds one scene file (a .sog is a ZIP of its own and stays as it is);
- a ``.ssog`` or ``.zip`` that holds the folder of a streamed SOG, and a ``.zip`` of a folder of SOG, of 3D Tiles, of a training
  or of parts, or of a .gltf with its buffers.

Each has a limit: what a server sends, and what a few compressed bytes may become.
"""

import gzip
import io
import os
import re
import shutil
import sys
import tempfile
import zipfile
import zlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

from splatree.errors import FormatError, InputError
from splatree.io.copying import TAKEN_MAX, copied
from splatree.io.formats.folder.manifest import MANIFEST, is_manifest
from splatree.io.objects import ObjectPath, located
from splatree.io.untrusted import inner_path
from splatree.progress import task

__all__ = ["LocalInputs", "is_brought", "is_fetched_whole", "local_inputs", "place_of"]

INFLATION_MAX = 100
"""How many times its size a compressed file may become; scenes become 1.2 to 5 times it."""

INFLATED_ALWAYS = 64 << 20
"""… unless it becomes no more than so many bytes."""

_OF_FOLDERS = ("lod-meta.json", "meta.json", MANIFEST)
"""Names of files that stand for a folder of others."""
_ZIPPED = (".zip", ".ssog", ".3tz")
"""Suffixes of ZIPs: of a streamed SOG, and of 3D Tiles."""
_ROOTS = (*_OF_FOLDERS, "tileset.json")
"""Names of files whose folder is a scene, also within a ZIP."""
_STANDARD_INPUT = "-"


@dataclass(frozen=True)
class LocalInputs:
    """Inputs as files of this machine."""

    paths: list[Path]
    """What to read, in order."""
    names: dict[str, str]
    """What the user named, by the path of what was brought here for it."""

    def named(self, path: str) -> str:
        """The name under which the user knows a path."""
        return self.names.get(path, path)


@contextmanager
def local_inputs(inputs: str | os.PathLike[str] | Sequence[str | os.PathLike[str]]) -> Iterator[LocalInputs]:
    """One input or several as files, for as long as the context lasts.

    Raises:
        InputError: an input is no path, a server does not give a file, or standard input is no .ply or .spz.
        FormatError: a compressed file is damaged, holds several files, or becomes too large.
    """
    folder: Path | None = None
    found, names = list[Path](), dict[str, str]()
    try:
        for number, named in enumerate(_paths(inputs)):
            path = place_of(named)
            bring = _how_to_bring(path)
            if bring is None:
                found.append(path)
                continue
            folder = folder or Path(tempfile.mkdtemp(prefix="splatree-"))
            place = folder / str(number)
            place.mkdir()
            local = bring(place)
            names[str(local)] = str(path)
            while (inflate := _how_to_inflate(local)) is not None:
                local = inflate(place)
                names[str(local)] = str(path)
            found.append(local)
        yield LocalInputs(found, names)
    except InputError as error:
        said = str(error)
        for inside in sorted(
            names, key=len, reverse=True
        ):  # the user knows no other name; a part of another comes after it
            said = said.replace(inside, names[inside])
        if said == str(error):
            raise
        raise type(error)(said) from error
    finally:
        if folder is not None:
            shutil.rmtree(folder, ignore_errors=True)


def _paths(inputs: str | os.PathLike[str] | Sequence[str | os.PathLike[str]]) -> list[Path]:
    """What a caller names, one path or several; anything else is refused."""
    given: Any = inputs
    is_one = isinstance(given, str | bytes | io.IOBase) or not isinstance(given, Iterable)
    named = [given] if is_one else list(given)
    for each in named:
        if not isinstance(each, str | os.PathLike) or not os.fspath(each):
            found = "an empty path" if isinstance(each, str) else type(each).__name__
            raise InputError(
                f"inputs: found {found}, wanted a path (str or pathlib.Path), or several; '.' is this folder"
            )
    return [Path(each) for each in named]


def place_of(named: Path) -> Path:
    """Where an input lies; of a folder of parts on a server, which tells no folders from files, the manifest."""
    path = located(named)
    return (
        path / MANIFEST if _is_of_server(path) and path.suffix == ".splatree" and is_manifest(path / MANIFEST) else path
    )


def is_fetched_whole(path: Path) -> bool:
    """Whether an input is one file of a server, which need not give ranges of it."""
    return _is_of_server(path) and place_of(path).name not in _OF_FOLDERS


def _is_of_server(path: Path) -> bool:
    return isinstance(path, ObjectPath) and re.match("https?:", str(path)) is not None


def is_brought(path: Path) -> bool:
    """Whether an input has to be fetched or unpacked before anything is known of it."""
    return _is_of_server(path) or path.suffix.lower() in (".gz", *_ZIPPED)


def _how_to_bring(path: Path) -> Callable[[Path], Path] | None:
    """What brings an input into a folder; None if it is a file already."""
    if str(path) == _STANDARD_INPUT and not path.exists():
        return _from_standard_input
    if _is_of_server(path) and path.name not in _OF_FOLDERS:
        return lambda folder: _download(str(path), folder)
    return _how_to_inflate(path)


def _how_to_inflate(path: Path) -> Callable[[Path], Path] | None:
    suffix = path.suffix.lower()
    if suffix == ".gz" and path.is_file():
        return lambda folder: _gunzip(path, folder, path.name[: -len(".gz")], str(path))
    if suffix in _ZIPPED and path.is_file():
        return _unzip(path)
    return None


def _download(address: str, folder: Path) -> Path:
    from splatree.io.download import download  # what it imports takes as long as the rest of the program

    got = download(address, folder)
    return _gunzip(got.path, folder / "plain", got.path.name, address) if got.is_packed else got.path


def _from_standard_input(folder: Path) -> Path:
    source: BinaryIO = sys.stdin.buffer
    head = source.read(4)
    suffix = "ply" if head[:3] == b"ply" else "spz" if head[:2] == b"\x1f\x8b" or head == b"NGSP" else None
    if suffix is None:
        raise InputError(
            f"-: found {head!r} at the beginning of standard input, wanted a .ply or an .spz; name a file instead"
        )
    target = folder / f"standard_input.{suffix}"
    with target.open("wb") as file:
        file.write(head)
        copied(source, file, TAKEN_MAX, "-", lambda _: None)
    return target


def _gunzip(path: Path, folder: Path, name: str, where: str) -> Path:
    """Unpack a file, which the user knows as ``where``."""
    folder.mkdir(exist_ok=True)
    target = folder / name
    limit = max(INFLATED_ALWAYS, INFLATION_MAX * path.stat().st_size)
    try:
        with (
            path.open("rb") as whole,
            gzip.open(whole) as packed,
            target.open("wb") as file,
            task(f"unpack {path.name}", None) as advance,
        ):
            copied(packed, file, limit, where, advance)  # type: ignore[arg-type]  # a GzipFile reads like any file
    except (OSError, EOFError, zlib.error) as error:
        if isinstance(error, FormatError):
            raise
        raise FormatError(f"{where}: not a whole .gz ({error}); fetch it again") from error
    return target


def _unzip(path: Path) -> Callable[[Path], Path] | None:
    """What unpacks a ZIP with one file or a streamed SOG; None for a bundle that is a scene of its own, or a checkpoint."""
    try:
        with path.open("rb") as file, zipfile.ZipFile(file) as bundle:
            entries = [e for e in bundle.infolist() if not e.is_dir() and not _is_litter(e.filename)]
    except (zipfile.BadZipFile, OSError, ValueError, NotImplementedError) as error:
        raise FormatError(f"{path}: not a whole ZIP ({error}); fetch it again") from error
    names = [entry.filename for entry in entries]
    if "meta.json" in names or any(name.endswith("/data.pkl") for name in names):
        return None
    if (root := _root_of(names)) is not None:
        return lambda folder: _unzip_all(path, entries, folder).joinpath(*root)
    if len(entries) != 1:
        raise FormatError(
            f"{path}: found {len(names)} files in it ({', '.join(names[:5])}{', ...' if len(names) > 5 else ''}), wanted one "
            "scene file, or one folder of SOG, 3D Tiles, glTF or a training; unpack it and name what to read"
        )
    (entry,) = entries

    def unpack(folder: Path) -> Path:
        target = folder / Path(entry.filename.replace("\\", "/")).name
        limit = max(INFLATED_ALWAYS, INFLATION_MAX * path.stat().st_size)
        _unzip_entry(path, entry, target, limit)
        return target

    return unpack


def _root_of(names: Iterable[str]) -> tuple[str, ...] | None:
    """Where in a ZIP the one scene lies that is a folder, or a file with others beside it; None without one, or of several.

    A stream has folders of SOG within, so the least deep counts.
    """
    found = set[tuple[str, ...]]()
    for name in names:
        *folders, last = parts = name.replace("\\", "/").split("/")
        if last in _ROOTS:
            found.add(tuple(folders))
        elif last.lower().endswith(".gltf"):
            found.add(tuple(parts))
        elif re.fullmatch(r"(.*/)?point_cloud/iteration_\d+/point_cloud\.ply", "/".join(parts)):
            found.add(tuple(folders[:-2]))
    least = [root for root in found if len(root) == min(map(len, found))]
    return least[0] if len(least) == 1 else None


def _unzip_all(path: Path, entries: Sequence[zipfile.ZipInfo], folder: Path) -> Path:
    """A folder of all entries, whose names may not lead out of it."""
    place = folder / path.stem
    left = max(INFLATED_ALWAYS, INFLATION_MAX * path.stat().st_size)
    for entry in entries:
        target = place / inner_path(entry.filename, str(path))
        target.parent.mkdir(parents=True, exist_ok=True)
        left -= _unzip_entry(path, entry, target, left)
    return place


def _unzip_entry(path: Path, entry: zipfile.ZipInfo, target: Path, limit: int) -> int:
    """Write one entry of a ZIP to a file; return its bytes."""
    try:
        with (
            path.open("rb") as whole,
            zipfile.ZipFile(whole) as bundle,
            bundle.open(entry) as packed,
            target.open("wb") as file,
            task(f"unpack {path.name}", entry.file_size) as advance,
        ):
            return copied(packed, file, limit, str(path), advance)  # type: ignore[arg-type]  # reads like any file
    except (zipfile.BadZipFile, OSError, EOFError, RuntimeError, NotImplementedError, zlib.error) as error:
        if isinstance(error, FormatError):
            raise
        raise FormatError(f"{path}: {entry.filename} cannot be unpacked ({error})") from error


def _is_litter(name: str) -> bool:
    """Whether an entry is what file managers add: folders of macOS, hidden files."""
    parts = name.replace("\\", "/").split("/")
    return "__MACOSX" in parts or parts[-1].startswith(".") or parts[-1].lower() in ("thumbs.db", "desktop.ini")
