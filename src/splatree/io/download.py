"""Download one file of a server, and go on where the connection broke off.

The rest is asked for as a range. It is taken if it begins where the file ends, and if size, ETag and Last-Modified say that it
is of the same state of the file. The file is given up where the server gives no ranges, sends no size or packs it on the way, and
where three connections one after the other brought no byte.
"""

import re
import time
from collections.abc import Callable
from dataclasses import dataclass
from http.client import HTTPException
from pathlib import Path
from typing import Any, BinaryIO
from urllib.error import HTTPError, URLError
from urllib.parse import unquote, urlsplit
from urllib.request import Request, urlopen

from splatree.errors import InputError
from splatree.io import http
from splatree.io.copying import TAKEN_MAX, copied
from splatree.io.sources import Info, parts_of, said_of
from splatree.progress import task

__all__ = ["Downloaded", "download"]


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
        with _asked(address) as answer:
            num_bytes, encoding = _announced(address, answer)
            known = said_of(address, 200, answer.headers) if num_bytes and encoding == "identity" else None
            with target.open("wb") as file, task(f"fetch {name}", num_bytes or None) as advance:
                _copy(address, answer, num_bytes, known, file, advance)
    except (URLError, HTTPException, OSError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{address}: cannot be fetched ({http.reason_of(error)})") from error
    return Downloaded(target, encoding != "identity")


def _asked(address: str, begin: int | None = None) -> Any:
    """The answer to a question for a file, or for the range from ``begin`` on."""
    headers = {"User-Agent": "splatree"} | ({} if begin is None else {"Range": f"bytes={begin}-"})
    return http.tried_again(lambda: urlopen(Request(address, headers=headers), timeout=http.TIMEOUT_S))


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


def _copy(
    address: str, answer: Any, num_bytes: int, known: Info | None, file: BinaryIO, advance: Callable[[float], None]
) -> None:
    """Write all bytes of a file, of which ``known`` says the state; None: it can't be gone on with."""
    in_vain = 0
    while True:
        begin, broken = file.tell(), None
        with answer:
            try:
                copied(answer, file, TAKEN_MAX - begin, address, advance)
            except (HTTPException, ConnectionError) as error:
                broken = error
        size = file.tell()
        if broken is None and (not num_bytes or size == num_bytes):
            return
        in_vain = 0 if size > begin else in_vain + 1
        rest = None if known is None or in_vain > len(http.WAITS_S) else _rest(address, known, size, in_vain)
        if rest is None:
            raise broken or InputError(
                f"{address}: found {size:,} of {num_bytes:,} bytes; the connection broke off, try again"
            )
        answer = rest


def _rest(address: str, known: Info, begin: int, in_vain: int) -> Any:
    """The answer with what follows the first bytes of a file; None: there is none of the same state."""
    if in_vain:
        time.sleep(http.WAITS_S[in_vain - 1])
    try:
        answer = _asked(address, begin)
    except HTTPError as error:
        error.close()
        return None
    begins = re.match(rf"bytes {begin}-", answer.headers.get("Content-Range", ""))
    if answer.status == 206 and begins and known.is_of(said_of(address, 206, answer.headers)):
        return answer
    answer.close()
    return None
