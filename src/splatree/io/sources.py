"""Where the bytes of addresses come from: ranges of them, sizes, names; and where they go.

``http`` and ``https`` are read by the standard library. All other schemes are those of fsspec, which finds the package that knows
them: s3fs for ``s3://``, gcsfs for ``gs://``, adlfs for ``az://``. `splatree.io.objects` makes paths of them.
"""

import re
import zlib
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Protocol
from urllib.parse import SplitResult, urlsplit

from splatree.errors import InputError, MissingExtraError, OutputError

__all__ = ["HEAD_BYTES", "Info", "Source", "parts_of", "source_of"]

HEAD_BYTES = 1 << 14
"""What a server is asked for to learn the size of a file: as long as the heads of most files, for no more waiting."""

_PACKAGES = "s3fs for s3://, gcsfs for gs://, adlfs for az://"


@dataclass(frozen=True)
class Info:
    """What is known of an object before its bytes are read."""

    num_bytes: int
    """Its size; 0 for a folder."""
    is_folder: bool = False
    """Whether other objects have its name and a slash before theirs."""
    version: int = 0
    """A number that is another when the object has been replaced."""
    head: bytes = field(default=b"", repr=False)
    """Its first bytes, if they came along."""
    stamps: frozenset[str] = frozenset()
    """What the server says of its state, of which each copy of a file may have its own: ETag and Last-Modified."""

    def is_of(self, later: "Info") -> bool:
        """Whether what is known later is of the same bytes: size, and one of the stamps where both have any."""
        alike = not self.stamps or not later.stamps or bool(self.stamps & later.stamps)
        return alike and self.num_bytes == later.num_bytes


class Source(Protocol):
    """What an address can be asked for."""

    def info(self, url: str) -> Info | None:
        """Size and kind; None: there is no such object."""

    def read(self, url: str, begin: int, end: int, known: Info | None = None) -> bytes:
        """The bytes ``begin`` to ``end``, fewer only where the object ends or the connection breaks off.

        Raises:
            InputError: they cannot be read, or a server says that they are of another object than what is ``known``.
        """

    def names(self, url: str) -> list[str]:
        """Names of what is in a folder."""

    def matches(self, url: str, pattern: str) -> list[str]:
        """What matches a pattern in a folder, without the name of the folder."""

    def put(self, local: Path, url: str) -> None:
        """Write a whole object."""

    def remove(self, url: str) -> None:
        """Remove an object."""


def source_of(url: str) -> Source:
    """What knows the scheme of an address.

    Raises:
        InputError: no package that is installed knows it.
        MissingExtraError: fsspec is not installed.
    """
    return _Http() if parts_of(url).scheme in ("http", "https") else _Fsspec.of(url)


def parts_of(url: str) -> SplitResult:
    """The parts of an address.

    Raises:
        InputError: it is none.
    """
    try:
        return urlsplit(url)
    except ValueError as error:
        raise InputError(f"{url}: found an address that is none ({error})") from error


def _said_of(url: str, status: int, headers: Any) -> Info:
    """What the answer of a server says of the whole object.

    Raises:
        InputError: it does not say the size.
    """
    whole = headers.get("Content-Range", "").rpartition("/")[2] if status == 206 else headers.get("Content-Length", "")
    if status != 416 and not (whole.isascii() and whole.isdigit()):
        raise InputError(f"{url}: found {whole!r} as its size, wanted a number of bytes; fetch the file yourself")
    modified = headers.get("Last-Modified")
    tag = (headers.get("ETag") or "").removeprefix("W/")  # one of them may come through a proxy that packs
    stamps = [
        stamp for stamp in (tag, modified) if stamp and stamp != headers.get("Date")
    ]  # the time of the answer says nothing
    version = zlib.crc32(stamps[0].encode()) if stamps else 0
    return Info(int(whole) if status != 416 else 0, version=version, stamps=frozenset(stamps))


class _Http:
    """Servers of HTTP, which give ranges, or answer with the whole."""

    def info(self, url: str) -> Info | None:
        status, headers, head = self._get(url, 0, HEAD_BYTES, missing_ok=True)
        if status == 404:
            return None
        found = _said_of(url, status, headers)
        return replace(found, head=head if len(head) == min(HEAD_BYTES, found.num_bytes) else b"")

    def read(self, url: str, begin: int, end: int, known: Info | None = None) -> bytes:
        status, headers, data = self._get(url, begin, end)
        if status != 206 and (status != 416 or known is None):  # 416: it has become shorter
            raise InputError(
                f"{url}: found a server that answers with the whole file (status {status}), wanted one that gives ranges of "
                "bytes; fetch the file yourself"
            )
        if known is not None and not known.is_of(_said_of(url, status, headers)):
            raise InputError(f"{url}: was replaced while it was read; read it again from its beginning")
        return data

    def names(self, url: str) -> list[str]:
        raise InputError(f"{url}: found a folder of a server, which does not list it; name the files")

    def matches(self, url: str, pattern: str) -> list[str]:
        return []  # nothing can be looked for

    def put(self, local: Path, url: str) -> None:
        raise OutputError(f"{url}: cannot be written, https is only read; name a file, or a store such as s3://")

    def remove(self, url: str) -> None:
        raise OutputError(f"{url}: cannot be removed, https is only read")

    def _get(self, url: str, begin: int, end: int, *, missing_ok: bool = False) -> tuple[int, Any, bytes]:
        """Status, headers, and the bytes if they are a range."""
        from http.client import HTTPException
        from urllib.error import HTTPError, URLError

        from splatree.io.http import open_range, reason_of  # what it imports takes as long as the rest of the program

        try:
            with open_range(url, begin, end) as answer:
                status, said = answer.status or 0, answer.headers.get("Content-Range", "")
                if status == 206 and not re.match(rf"bytes {begin}-", said):
                    raise InputError(
                        f"{url}: found a server that answers with the range {said!r}, wanted the bytes from {begin} on; fetch "
                        "the file yourself"
                    )
                return status, answer.headers, answer.read() if status == 206 else b""
        except HTTPError as error:
            with error:
                if error.code == 416 or (error.code == 404 and missing_ok):  # 416: of no bytes at all
                    return error.code, error.headers, b""
                raise InputError(f"{url}: cannot be fetched ({reason_of(error)})") from error
        except InputError:
            raise
        except (URLError, HTTPException, OSError, ValueError) as error:
            raise InputError(f"{url}: cannot be fetched ({reason_of(error)})") from error


@dataclass(frozen=True)
class _Fsspec:
    """Object stores and other file systems that fsspec knows."""

    files: Any
    """The file system."""

    @staticmethod
    def of(url: str) -> "_Fsspec":
        scheme = parts_of(url).scheme
        try:
            import fsspec
        except ImportError as error:
            raise MissingExtraError("fsspec", "cloud", f"{url}: reading and writing {scheme}://") from error
        try:
            return _Fsspec(fsspec.core.url_to_fs(url)[0])
        except ImportError as error:
            raise InputError(f"{url}: found no package for {scheme}:// ({error}); install it: {_PACKAGES}") from error
        except ValueError as error:
            raise InputError(
                f"{url}: found an address of {scheme}, wanted https, file, or what fsspec knows: {_PACKAGES}"
            ) from error

    def info(self, url: str) -> Info | None:
        try:
            found = self.files.info(self._name(url))
        except FileNotFoundError:
            return None
        except Exception as error:  # each store has its own, of packages that need not be there
            raise _unread(url, error) from error
        stamp = next((found[key] for key in ("ETag", "etag", "LastModified", "mtime", "created") if key in found), "")
        return Info(int(found.get("size") or 0), found["type"] == "directory", zlib.crc32(str(stamp).encode()))

    def read(self, url: str, begin: int, end: int, known: Info | None = None) -> bytes:
        try:  # what a store says of an object comes with no range: asking would take a request more for each
            return bytes(self.files.cat_file(self._name(url), start=begin, end=end))
        except Exception as error:
            raise _unread(url, error) from error

    def names(self, url: str) -> list[str]:
        try:
            listed = self.files.ls(self._name(url), detail=False)
        except Exception as error:
            raise _unread(url, error) from error
        return [name.rstrip("/").rpartition("/")[2] for name in listed]

    def matches(self, url: str, pattern: str) -> list[str]:
        folder = self._name(url).rstrip("/")
        try:
            found = self.files.glob(f"{folder}/{pattern}")
        except Exception as error:
            raise _unread(url, error) from error
        return [name[len(folder) :].lstrip("/") for name in found]

    def put(self, local: Path, url: str) -> None:
        try:
            self.files.put_file(str(local), self._name(url))
        except Exception as error:
            raise OutputError(f"{url}: could not be written ({_said(error)})") from error

    def remove(self, url: str) -> None:
        try:
            self.files.rm_file(self._name(url))
        except Exception as error:
            raise OutputError(f"{url}: could not be removed ({_said(error)})") from error

    def _name(self, url: str) -> str:
        return str(self.files._strip_protocol(url))


def _unread(url: str, error: Exception) -> InputError:
    if isinstance(error, FileNotFoundError):
        return InputError(f"{url}: not found; wanted an object or a folder")
    return InputError(f"{url}: cannot be read ({_said(error)})")


def _said(error: Exception) -> str:
    return str(error) or type(error).__name__
