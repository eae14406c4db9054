"""Download one file of a server, and go on where the connection broke off.

The rest is asked for as a range. It is taken if it begins where the file ends, and if what the server said of the state of
the file (size, strong ETag, Last-Modified) is what it says now. The file is given up where the server says nothing of the state,
gives no ranges or packs the file on the way, and where three connections one after the other broke off or fell silent before a
megabyte came.
"""

import re
import time
from collections.abc import Callable
from dataclasses import dataclass
from http.client import HTTPException
from pathlib import Path
from typing import Any, BinaryIO
from urllib.error import URLError
from urllib.parse import unquote, urlsplit
from urllib.request import Request, urlopen

from splatree.errors import InputError
from splatree.io import http
from splatree.io.copying import TAKEN_MAX, copied
from splatree.io.sources import parts_of
from splatree.progress import task

__all__ = ["Downloaded", "download"]

ENOUGH_BYTES = 1 << 20
"""A connection that brought so many was worth it."""

_STAMPS = ("ETag", "Last-Modified")


@dataclass(frozen=True)
class Downloaded:
    """One file of a server, as a file of this machine."""

    path: Path
    is_packed: bool
    """Whether the server packed it by gzip on the way."""


def download(address: str, folder: Path) -> Downloaded:
    """Fetch a file into a folder, under its own name.

    Raises:
        InputError: the server does not give it, or not all of it.
    """
    name = Path(unquote(parts_of(address).path)).name or "scene"
    target = folder / re.sub(r"[^\w.-]", "_", name)
    try:
        with _asked(address, {}) as answer:
            num_bytes, encoding = _announced(address, answer)
            stamps = _stamps(answer) if num_bytes and encoding == "identity" else {}
            with target.open("wb") as file, task(f"fetch {name}", num_bytes or None) as advance:
                _copy(address, answer, num_bytes, stamps, file, advance)
    except (URLError, HTTPException, OSError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{address}: cannot be fetched ({http.reason_of(error)})") from error
    return Downloaded(target, encoding != "identity")


def _asked(address: str, headers: dict[str, str]) -> Any:
    """The answer to a question for a file."""
    request = Request(address, headers={"User-Agent": "splatree", **headers})
    return http.tried_again(lambda: urlopen(request, timeout=http.TIMEOUT_S))


def _announced(address: str, answer: Any) -> tuple[int, str]:
    """How many bytes a server means to send, 0 if it does not say, and how they are encoded."""
    if urlsplit(answer.url).scheme not in ("http", "https"):
        raise InputError(f"{address}: leads to {answer.url}, wanted https or http")
    said = answer.headers.get("Content-Length") or "0"
    if not (said.isascii() and said.isdigit()):
        raise InputError(f"{address}: found {said!r} as its size, wanted a number of bytes; fetch it yourself")
    if int(said) > TAKEN_MAX:
        raise InputError(f"{address}: found {int(said):,} bytes, wanted at most {TAKEN_MAX:,}; fetch it yourself")
    encoding = (answer.headers.get("Content-Encoding") or "identity").lower()
    if encoding not in ("identity", "gzip", "x-gzip"):
        raise InputError(f"{address}: found it encoded as {encoding}, wanted it plain or as gzip; fetch it yourself")
    return int(said), encoding


def _stamps(answer: Any) -> dict[str, str]:
    """What a server says of the state of a file, if that tells two states apart."""
    said = {name: answer.headers.get(name, "") for name in _STAMPS}
    return {name: stamp for name, stamp in said.items() if stamp and not stamp.startswith("W/")}


def _copy(
    address: str,
    answer: Any,
    num_bytes: int,
    stamps: dict[str, str],
    file: BinaryIO,
    advance: Callable[[float], None],
) -> None:
    """Write all bytes of a file, of which ``stamps`` say the state; without any it can't be gone on with."""
    in_vain = 0
    while True:
        begin, broken = file.tell(), None
        try:
            with answer or _rest(address, num_bytes, stamps, begin) as source:
                copied(source, file, TAKEN_MAX - begin, address, advance)
        except InputError:
            raise
        except (HTTPException, OSError) as error:
            broken = error
        size, answer = file.tell(), None
        if broken is None and (not num_bytes or size == num_bytes):
            return
        in_vain = 0 if size - begin >= ENOUGH_BYTES else in_vain + 1
        if not stamps or in_vain > len(http.WAITS_S):
            raise broken or _broken_off(address, size, num_bytes)
        if in_vain:
            time.sleep(http.WAITS_S[in_vain - 1])


def _rest(address: str, num_bytes: int, stamps: dict[str, str], begin: int) -> Any:
    """The answer with what follows the first bytes of a file.

    Raises:
        InputError: there is none of the same state.
    """
    answer = _asked(address, {"Range": f"bytes={begin}-", "If-Range": next(iter(stamps.values()))})
    said = answer.headers.get("Content-Range", ""), answer.headers.get("Content-Encoding", "identity")
    if answer.status == 206 and said == (f"bytes {begin}-{num_bytes - 1}/{num_bytes}", "identity"):
        now = _stamps(answer)
        if all(now.get(name) == stamp for name, stamp in stamps.items()):
            return answer
    answer.close()
    raise _broken_off(address, begin, num_bytes)


def _broken_off(address: str, size: int, num_bytes: int) -> InputError:
    return InputError(f"{address}: found {size:,} of {num_bytes:,} bytes; the connection broke off, try again")
