"""The parts of a stream in a folder: each is there whole or not at all, and is not made again.

The name of a part ends in a digest of what it is made from. So a part with the right name has the right contents: a stream
that was interrupted goes on where it stopped, one that is made again with other options replaces only what differs, and the
parts of the old stream stay whole until the new manifest, which is written last, names others.
"""

import hashlib
import os
import re
import shutil
from collections.abc import Iterable, Mapping
from dataclasses import fields
from pathlib import Path

from splatree.errors import OutputError
from splatree.io.replacing import replacing
from splatree.scene.gaussians import Gaussians

__all__ = ["Folder", "digest_of"]

_REVISION = b"1"
"""Of what parts are made by: another one gives parts other names."""

_PART = re.compile(r"^[0-9a-z_]+-[0-9a-f]{12}(\.glb)?$")


def digest_of(gaussians: Gaussians, *more: object) -> str:
    """Twelve digits that stand for all values of the Gaussians and for ``more``."""
    state = hashlib.blake2b(_REVISION, digest_size=6)
    for column in fields(gaussians):
        state.update(getattr(gaussians, column.name))
    state.update(repr(more).encode())
    return state.hexdigest()


class Folder:
    """A folder that a stream is written to."""

    def __init__(self, path: Path, manifest: str, *, force: bool) -> None:
        """Make the folder, or take one that holds nothing, parts of an interrupted stream, or with ``force`` an old stream.

        Raises:
            OutputError: it holds something else, or cannot be made.
        """
        self.path, self._manifest = path, path / manifest
        if path.exists() and not path.is_dir():
            raise OutputError(f"{path}: is a file, wanted a folder to write the stream to")
        if not path.parent.is_dir():
            raise OutputError(f"{path}: cannot be written, there is no folder {path.parent}")
        names = [entry.name for entry in path.iterdir()] if path.is_dir() else []
        if self._manifest.exists() and not force:
            raise OutputError(
                f"{path}: holds a stream already; choose another folder or replace it with force (--force)"
            )
        foreign = [name for name in names if not _PART.match(name) and not _is_unfinished(name) and name != manifest]
        if foreign and not force:
            raise OutputError(
                f"{path}: holds {foreign[0]}, wanted a new or an empty folder; with force (--force) the stream is written "
                "beside it"
            )
        try:
            path.mkdir(exist_ok=True)
        except OSError as error:
            raise OutputError(f"{path}: cannot be made ({error.strerror or error})") from error

    def has(self, name: str) -> bool:
        """Whether the part is there."""
        return (self.path / name).exists()

    def write_part(self, name: str, files: Mapping[str, bytes]) -> None:
        """Write a part that is a folder of files."""
        temporary = self.path / f".{name}.{os.urandom(4).hex()}.tmp"
        try:
            temporary.mkdir()
            for file, data in files.items():
                (temporary / file).write_bytes(data)
            temporary.rename(self.path / name)
        except OSError as error:
            if self.has(name):  # another process that writes the same stream was first
                return
            raise OutputError(f"{self.path / name}: could not be written ({error.strerror or error})") from error
        finally:
            shutil.rmtree(temporary, ignore_errors=True)

    def write_file(self, name: str, data: bytes) -> None:
        """Write a part that is a file."""
        with replacing(self.path / name, force=True) as temporary:
            temporary.write_bytes(data)

    def part_bytes(self, name: str) -> int:
        """Size of a part."""
        part = self.path / name
        return sum(file.stat().st_size for file in part.iterdir()) if part.is_dir() else part.stat().st_size

    def finish(self, manifest: str, parts: Iterable[str]) -> None:
        """Write the manifest, then remove parts that it does not name."""
        with replacing(self._manifest, force=True) as temporary:
            temporary.write_text(manifest, "utf-8")
        named = set(parts)
        for entry in self.path.iterdir():
            if _is_unfinished(entry.name) or (_PART.match(entry.name) and entry.name not in named):
                shutil.rmtree(entry) if entry.is_dir() else entry.unlink()


def _is_unfinished(name: str) -> bool:
    """Whether the name is that of a part, or a manifest, which was being written."""
    return name.startswith(".") and name.endswith(".tmp")
