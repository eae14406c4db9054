"""``manifest.json`` of a scene in a folder: which files there are, their sizes and their digests.

Nothing of a manifest is believed before it is checked: names must lead to plain files inside the folder, and each file must have
the size and the digest that are said. So a file that was cut off, flipped or taken from another build is never read.
"""

import hashlib
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from splatree.errors import FormatError, InputError
from splatree.io import untrusted
from splatree.io.objects import ObjectPath, at_once

__all__ = [
    "MANIFEST",
    "Manifest",
    "StoredFile",
    "digest_of",
    "folder_of",
    "holds_parts",
    "is_manifest",
    "read_manifest",
    "stored_file",
]

MANIFEST = "manifest.json"
"""Name of the manifest."""

KIND = "splatree-folder"
VERSION = 1
FILES_MAX = 1 << 20


@dataclass(frozen=True)
class StoredFile:
    """A file of the folder."""

    name: str
    """Its path inside the folder."""
    num_bytes: int
    """Its size."""
    digest: str
    """The first 16 bytes of the SHA-256 of its bytes, in hexadecimal digits."""


@dataclass(frozen=True)
class Manifest:
    """What the folder holds."""

    num_rows: int
    """Leaves and merged nodes of the whole tree."""
    num_leaves: int
    """Leaves of the whole tree."""
    crown: StoredFile
    """The nodes above the parts, and below them, as leaves, the roots of all parts; ids number these roots part by part."""
    parts: tuple[StoredFile, ...]
    """Whole subtrees, each file a ``.splatree``."""
    index: StoredFile | None = None
    """What a selection by pages has to know beforehand (io/pages/index_file.py); None in folders of before: it is made anew."""

    def to_json(self) -> str:
        """The text of the file."""
        fields = {name: value for name, value in asdict(self).items() if value is not None}
        return json.dumps({"format": KIND, "version": VERSION, **fields}, indent=1)


def digest_of(path: Path) -> str:
    """The first half of the SHA-256 of the bytes of a file, for which processors have instructions."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()[:32]


def stored_file(folder: Path, name: str) -> StoredFile:
    """What a manifest says of a file that was just written."""
    return StoredFile(name, (folder / name).stat().st_size, digest_of(folder / name))


def folder_of(path: Path) -> Path:
    """The folder, which its manifest may stand for."""
    return path.parent if path.name == MANIFEST else path


def is_manifest(path: Path) -> bool:
    """Whether a file is the manifest of a scene in a folder.

    Servers answer for a file that is not there as they like: "not found", "forbidden", or with a page. Where a server cannot be
    asked at all, the next question to it says so.
    """
    try:
        with path.open("rb") as file:
            return f'"format": "{KIND}"'.encode() in file.read(256)
    except (OSError, InputError):
        return False


def holds_parts(folder: Path) -> bool:
    """Whether a folder is a scene in parts, or what is left of one.

    A crown and parts are one whatever the manifest says: the crown alone would pass for a scene.
    """
    return is_manifest(folder / MANIFEST) or (
        folder.is_dir() and any(folder.glob("crown*.splatree")) and any(folder.glob("parts/*.splatree"))
    )


def read_manifest(folder: Path) -> Manifest:
    """Read and check the manifest of a folder; the files themselves are not read.

    Raises:
        FormatError: the manifest is damaged or of a newer version, or a file is missing, outside of the folder
            or of another size.
    """
    path = folder / MANIFEST
    where = str(path)
    if not path.is_file():
        raise FormatError(
            f"{where}: not found, but {folder} holds parts of a scene: its build or its copy is not whole; build or copy it again"
        )
    fields = untrusted.as_object(untrusted.read_json(path), where)
    if untrusted.text(fields, "format", where) != KIND:
        raise FormatError(f"{where}: found format {fields['format']!r}, wanted {KIND!r}")
    untrusted.integer(fields, "version", where, low=1, high=VERSION)
    parts = untrusted.as_list(untrusted.field(fields, "parts", where), f"{where}: parts")
    if not 1 <= len(parts) <= FILES_MAX:
        raise FormatError(f"{where}: found {len(parts)} parts, wanted 1 to {FILES_MAX}")
    if isinstance(folder, ObjectPath):
        _look_up(folder, parts)
    files = [_file(folder, part, f"{where}: parts[{i}]") for i, part in enumerate(parts)]
    if len({file.name for file in files}) < len(files):
        raise FormatError(f"{where}: found a part that is named twice")
    return Manifest(
        num_rows=untrusted.integer(fields, "num_rows", where, high=2**53),
        num_leaves=untrusted.integer(fields, "num_leaves", where, high=2**53),
        crown=_file(folder, untrusted.field(fields, "crown", where), f"{where}: crown"),
        parts=tuple(files),
        index=_file(folder, fields["index"], f"{where}: index") if "index" in fields else None,
    )


def checked_path(folder: Path, file: StoredFile) -> Path:
    """The path of a file whose bytes are those that the manifest speaks of.

    Raises:
        FormatError: they are not.
    """
    path = untrusted.inner_file(folder, file.name, str(folder / MANIFEST))
    if (found := digest_of(path)) != file.digest:
        raise FormatError(
            f"{path}: found digest {found}, wanted {file.digest} as {MANIFEST} says; the file is damaged or of another build: "
            "build the scene again"
        )
    return path


def _look_up(folder: ObjectPath, parts: Sequence[object]) -> None:
    """Ask for the sizes of all parts at the same time; what is wrong with one is said where each is looked at."""
    names = [part["name"] for part in parts if isinstance(part, dict) and isinstance(part.get("name"), str)]
    at_once(ObjectPath.info, [folder / untrusted.inner_path(name, str(folder / MANIFEST)) for name in names])


def _file(folder: Path, value: object, where: str) -> StoredFile:
    fields = untrusted.as_object(value, where)
    name = untrusted.text(fields, "name", where)
    path = untrusted.inner_file(folder, name, where)
    num_bytes = untrusted.integer(fields, "num_bytes", where, high=2**53)
    if (found := path.stat().st_size) != num_bytes:
        raise FormatError(
            f"{path}: found {found} bytes, wanted {num_bytes} as {MANIFEST} says; the file is cut off or of another build"
        )
    return StoredFile(name, num_bytes, untrusted.text(fields, "digest", where))


def total_bytes(files: Sequence[StoredFile]) -> int:
    """Bytes of several files."""
    return sum(file.num_bytes for file in files)
