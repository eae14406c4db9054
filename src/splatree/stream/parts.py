"""The parts of a stream in a folder: each is there whole or not at all, and is not made again.

The name of a part ends in two digests: of what it is made from, and of what it holds. By the first a stream finds its parts
again: one that was interrupted goes on where it stopped, and one that is made again with other options replaces only what
differs. By the second it sees whether they are whole: a part that is damaged is made again. The parts of an older stream stay
until the new manifest, which is written last, names others.

Cost: what is kept is read once, at about 1 GB a CPU-second.
"""

import hashlib
import os
import re
import shutil
from collections.abc import Callable, Iterable, Mapping
from dataclasses import fields
from pathlib import Path
from typing import Self

from splatree.errors import OutputError, SplatreeError
from splatree.io.replacing import flush, name_in, replacing
from splatree.scene.gaussians import Gaussians
from splatree.scene.literals import as_python

__all__ = ["Folder", "check_folder", "digest_of", "write_files"]

_REVISION = b"1"
"""Of what parts are made by: another one gives parts other names."""

_DIGITS = 12
"""Hexadecimal digits of a digest."""

_PART = re.compile(r"^[0-9a-z_]+(-[0-9a-f]{12}){1,2}(\.glb)?$")
"""Names of parts; those with one digest are of an older stream, and are not kept."""


def digest_of(gaussians: Gaussians, *more: object) -> str:
    """Twelve digits that stand for all values of the Gaussians and for ``more``."""
    state = hashlib.blake2b(_REVISION, digest_size=_DIGITS // 2)
    for column in fields(gaussians):
        state.update(getattr(gaussians, column.name))
    state.update(repr(as_python(more)).encode())
    return state.hexdigest()


def check_folder(path: Path, manifest: str, *, force: bool) -> list[str]:
    """Refuse a place where no stream can be written; the names that are there.

    Raises:
        OutputError: it is a file, or has no folder around it, or holds something else than parts of an interrupted stream, or
            without ``force`` than an old stream.
    """
    if path.exists() and not path.is_dir():
        raise OutputError(f"{path}: is a file, wanted a folder to write the stream to")
    if not path.parent.is_dir():
        raise OutputError(f"{path}: cannot be written, there is no folder {path.parent}")
    names = [entry.name for entry in path.iterdir()] if path.is_dir() else []
    if manifest in names and not force:
        raise OutputError(f"{path}: holds a stream already; choose another folder or replace it with force (--force)")
    foreign = [name for name in names if not _PART.match(name) and not _is_unfinished(name) and name != manifest]
    if foreign and not force:
        raise OutputError(
            f"{path}: holds {foreign[0]}, wanted a new or an empty folder; with force (--force) the stream is written "
            "beside it"
        )
    return names


class Folder:
    """A folder that a stream is written to."""

    def __init__(self, path: Path, manifest: str, *, force: bool) -> None:
        """Make the folder, or take one that holds nothing, parts of an interrupted stream, or with ``force`` an old stream.

        Raises:
            OutputError: it holds something else, or cannot be made.
        """
        names = check_folder(path, manifest, force=force)
        self.path, self._manifest, self._is_new = path, path / manifest, not path.exists()
        try:
            path.mkdir(exist_ok=True)
        except OSError as error:
            raise OutputError(f"{path}: cannot be made ({error.strerror or error})") from error
        self._there: dict[str, list[str]] = {}
        for name in names:
            if _PART.match(name):
                self._there.setdefault(name.rpartition("-")[0], []).append(name)
        self.damaged: list[str] = []
        """Parts that were there, and did not hold what they were written with."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        """Leave no empty folder behind a failure."""
        if kind is not None and self._is_new and not any(self.path.iterdir()):
            self.path.rmdir()

    def find(self, name: str) -> str | None:
        """The whole name of the part that is there by a name without the digest of what it holds; None: there is none, or it is
        damaged."""
        for whole in self._there.get(name, ()):
            if self._is_whole(whole):
                return whole
            self.damaged.append(whole)
        return None

    def make(self, name: str, write: Callable[[Path], object], suffix: str = "") -> str:
        """Make a part, which ``write`` writes as a file or a folder to a path; its whole name.

        Raises:
            OutputError: the disk fails.
        """
        temporary = self.path / f".{name}.{os.urandom(4).hex()}.tmp"
        try:
            write(temporary)
            for file in _files_of(temporary):
                flush(file, os.O_RDWR)
            whole = f"{name}-{_digest_of_part(temporary)}{suffix}"
            if (self.path / whole).is_dir() and not self._is_whole(whole):
                shutil.rmtree(self.path / whole)
            try:
                temporary.replace(self.path / whole)
            except OSError:
                if not self._is_whole(whole):  # no other process that writes the same stream was first
                    raise
        except SplatreeError as error:
            error.args = tuple(name_in(str(part), temporary, self.path) for part in error.args)
            raise
        except OSError as error:
            raise OutputError(f"{self.path / name}: could not be written ({error.strerror or error})") from error
        finally:
            if temporary.is_dir():
                shutil.rmtree(temporary, ignore_errors=True)
            else:
                temporary.unlink(missing_ok=True)
        return whole

    def _is_whole(self, whole: str) -> bool:
        """Whether a part is there and holds what its name says."""
        try:
            return _digest_of_part(self.path / whole) == whole.partition(".")[0][-_DIGITS:]
        except OSError:
            return False

    def part_bytes(self, name: str) -> int:
        """Size of a part."""
        return sum(file.stat().st_size for file in _files_of(self.path / name))

    def finish(self, manifest: str, parts: Iterable[str]) -> None:
        """Write the manifest, then remove parts that it does not name."""
        with replacing(self._manifest, force=True) as temporary:
            temporary.write_text(manifest, "utf-8")
        named = set(parts)
        for entry in self.path.iterdir():
            if _is_unfinished(entry.name) or (_PART.match(entry.name) and entry.name not in named):
                shutil.rmtree(entry) if entry.is_dir() else entry.unlink()


def write_files(files: Mapping[str, bytes], path: Path) -> None:
    """Write a part that is a folder of files."""
    path.mkdir()
    for name, data in files.items():
        (path / name).write_bytes(data)


def _digest_of_part(path: Path) -> str:
    """Digits that stand for the contents of a file, or for the names and contents of the files of a folder."""
    state = hashlib.blake2b(digest_size=_DIGITS // 2)
    for file in _files_of(path):
        data = file.read_bytes()
        state.update(f"{'' if file == path else file.name} {len(data)}\n".encode())
        state.update(data)
    return state.hexdigest()


def _files_of(part: Path) -> list[Path]:
    return sorted(part.iterdir()) if part.is_dir() else [part]


def _is_unfinished(name: str) -> bool:
    """Whether the name is that of a part, or a manifest, which was being written."""
    return name.startswith(".") and name.endswith(".tmp")
