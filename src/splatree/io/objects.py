"""Paths that stand for addresses: ``s3://bucket/city.ply`` is opened, listed and joined as a file of this machine is.

`located` makes one of what a user names. Readers open a path, look at its size and read; so they read from a store without
knowing of it. A file that is opened asks for ranges, at first small ones, and larger ones while it is read on in order. Writers
write a file of this machine, which is sent when it is whole (`splatree.io.replacing`).
"""

import io
import os
import re
import stat
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from typing import IO, Any, Self, TypeVar
from urllib.parse import unquote

from splatree.errors import InputError
from splatree.io.sources import HEAD_BYTES, Info, source_of

__all__ = ["MOST_BYTES", "ObjectPath", "at_once", "located"]

FIRST_BYTES = 1 << 16
"""A header, or what a format is known by, is in so many."""

MOST_BYTES = 1 << 23
"""8 MB: a request takes 30 to 100 ms before its first byte, and these bytes about as long at 100 MB/s."""

AT_ONCE = 16
"""Requests that are under way at the same time."""

_ADDRESS = re.compile(r"([a-z][a-z0-9+.-]{1,15}):/+(.*)", re.IGNORECASE | re.DOTALL)

_Asked = TypeVar("_Asked")
_Found = TypeVar("_Found")

_known: dict[str, Info | None] = {}
"""What was found of addresses since one was last named: a format looks for one file many times."""


class ObjectPath(type(Path())):  # type: ignore[misc]  # PosixPath or WindowsPath: which of them, only the system knows
    """The path of an object, or of a folder of a store; only what is said here differs from other paths."""

    def __str__(self) -> str:
        text = super().__str__().replace("\\", "/")
        match = _ADDRESS.fullmatch(text)
        return text if match is None else f"{match[1].lower()}://{match[2]}"  # relative to another: no address

    def __fspath__(self) -> str:
        return str(self)

    def info(self) -> Info | None:
        """Size and kind; None: it is not there.

        Raises:
            InputError: the store cannot be asked.
        """
        url = str(self)
        with suppress(KeyError):  # another thread may name an address at any time, which empties it
            return _known[url]
        found = _known[url] = source_of(url).info(url)
        return found

    def read_range(self, begin: int, end: int, known: Info | None = None) -> bytes:
        """The bytes ``begin`` to ``end``; ``known`` is what the reader was told of the object when it began to read it.

        Raises:
            InputError: they cannot be read, are fewer, or are of an object that has replaced that one.
        """
        if begin >= end:
            return b""
        known = known or _known.get(str(self))
        if known is not None and end <= len(known.head):
            return known.head[begin:end]
        data = source_of(str(self)).read(str(self), begin, end, known)
        if len(data) != end - begin:
            raise InputError(
                f"{self}: found {len(data):,} of {end - begin:,} bytes from byte {begin:,} on; the connection broke off or the "
                "object was replaced meanwhile, try again"
            )
        return data

    def put(self, local: Path) -> None:
        """Write the object, whole or not at all.

        Raises:
            OutputError: the store refuses.
        """
        source_of(str(self)).put(local, str(self))
        _known.clear()

    def unlink(self, missing_ok: bool = False) -> None:
        if self.info() is not None or not missing_ok:
            source_of(str(self)).remove(str(self))
            _known.clear()

    def stat(self, *, follow_symlinks: bool = True) -> os.stat_result:
        info = self.info()
        if info is None:
            raise FileNotFoundError(2, "No such object", str(self))
        kind = stat.S_IFDIR if info.is_folder else stat.S_IFREG
        place = hash(str(self)) & (2**63 - 1)  # links lead nowhere: each address is an object of its own
        known = (kind | 0o444, place, 0, 1, 0, 0, info.num_bytes, 0, info.version, 0)
        return os.stat_result(known, {"st_mtime_ns": info.version})

    def exists(self, *, follow_symlinks: bool = True) -> bool:
        return self.info() is not None

    def is_file(self, *, follow_symlinks: bool = True) -> bool:
        return (info := self.info()) is not None and not info.is_folder

    def is_dir(self, *, follow_symlinks: bool = True) -> bool:
        return (info := self.info()) is not None and info.is_folder

    def open(self, mode: str = "r", buffering: int = -1, *_: Any, **__: Any) -> IO[Any]:
        if mode != "rb":
            raise InputError(f"{self}: found an address to be opened for {mode!r}, wanted 'rb'; objects are put whole")
        raw = _ObjectFile(self)
        return raw if buffering == 0 else io.BufferedReader(raw, HEAD_BYTES)  # type: ignore[return-value]

    def read_bytes(self) -> bytes:
        return self.read_range(0, self.stat().st_size)

    def read_text(self, encoding: str | None = None, errors: str | None = None, newline: str | None = None) -> str:
        return self.read_bytes().decode(encoding or "utf-8", errors or "strict")

    def iterdir(self) -> Iterator[Self]:
        return (self / name for name in source_of(str(self)).names(str(self)))

    def glob(self, pattern: str, **_: Any) -> Iterator[Self]:
        return (self / name for name in source_of(str(self)).matches(str(self), pattern))

    def absolute(self) -> Self:
        return self

    def resolve(self, strict: bool = False) -> Self:
        if strict:
            self.stat()
        return self


class _ObjectFile(io.RawIOBase):
    """An object that is read by ranges."""

    def __init__(self, path: ObjectPath) -> None:
        self._path, self._size, self._info = path, path.stat().st_size, path.info()
        self._block = b"" if self._info is None else self._info.head
        self._place, self._begin = 0, 0 if self._block else -1
        self._ahead = FIRST_BYTES

    def readable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        self._place = offset + (0, self._place, self._size)[whence]
        return self._place

    def readinto(self, buffer: Any) -> int:
        """Fill the whole buffer, or what there is to the end."""
        wanted = memoryview(buffer).cast("B")[: max(0, self._size - self._place)]
        done = 0
        while done < len(wanted):
            first = self._place - self._begin
            if not 0 <= first < len(self._block):
                self._fetch(len(wanted) - done)
                first = 0
            part = self._block[first : first + len(wanted) - done]
            wanted[done : done + len(part)] = part
            done += len(part)
            self._place += len(part)
        return done

    def _fetch(self, count: int) -> None:
        goes_on = self._place == self._begin + len(self._block)
        self._ahead = min(2 * self._ahead, MOST_BYTES) if goes_on else FIRST_BYTES
        self._begin = self._place
        end = min(self._size, self._place + max(self._ahead, min(count, MOST_BYTES)))
        self._block = self._path.read_range(self._begin, end, self._info)


def located(path: str | os.PathLike[str]) -> Path:
    """The path that a user names: of an address a path that reads from there, of others the path itself."""
    if isinstance(path, ObjectPath):
        return path
    if "\0" in str(path):
        raise InputError(f"{str(path)!r}: found a zero in a path, wanted letters that a name can have")
    match = _ADDRESS.fullmatch(str(path).replace("\\", "/"))
    if match is None:
        return Path(path)
    if match[1].lower() == "file":
        return Path(f"/{unquote(match[2])}")
    _known.clear()
    return ObjectPath(f"{match[1].lower()}://{match[2]}")


def at_once(ask: Callable[[_Asked], _Found], asked: Sequence[_Asked]) -> list[_Found]:
    """What ``ask`` finds of each, in order; for what waits for a store and not for the processor."""
    if len(asked) < 2:
        return [ask(each) for each in asked]
    with ThreadPoolExecutor(min(AT_ONCE, len(asked)), "splatree-store") as pool:
        return list(pool.map(ask, asked))
