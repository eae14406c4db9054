"""Ranges of files on servers of HTTP, over connections that stay open.

A new connection of https takes two to three round trips before its first request; a request over one that is there takes one.
So a connection is kept when its answer has been read to the end, and the next request to the same server takes it, from whichever
thread. As many are open as requests were under way at the same time.

A server that is busy, and a connection that breaks off, are asked again (`tried_again`): a picture of a scene elsewhere takes
hundreds of requests, and one of them fails now and then.

Redirections and proxies are left to the standard library, which by itself closes a connection after each request.
"""

import atexit
import io
import os
import threading
import time
from collections import defaultdict
from collections.abc import Callable, Hashable
from functools import cache
from http.client import HTTPConnection, HTTPException, HTTPResponse, IncompleteRead, InvalidURL
from typing import Any, Final, TypeVar
from urllib.error import HTTPError
from urllib.request import HTTPHandler, HTTPSHandler, OpenerDirector, Request, build_opener
from urllib.response import addinfourl

__all__ = ["TIMEOUT_S", "close_connections", "open_range", "reason_of", "tried_again"]

_Answer = TypeVar("_Answer")

TIMEOUT_S = 30.0
"""A server that sends nothing for so long is given up."""

IDLE_S = 20.0
"""A connection that has waited for so long is closed: routers on the way forget it and tell nobody."""

MOST_IDLE = 16
"""Connections to one server that wait for the next request."""

WAITS_S = (0.5, 2.0)
"""Before a request is made again: a server that is busy, or starts anew, needs about as long."""

_BUSY: Final = (429, 500, 502, 503, 504)
"""Status of answers that may be others a little later."""

_LEAST_BYTES = 1 << 16
"""What is read of an answer at least, so that the connection is kept after the page of an error, too."""


def open_range(url: str, begin: int, end: int) -> addinfourl:
    """Ask for the bytes ``begin`` to ``end`` of a file; the answer has its status, its headers, and the bytes that came.

    Raises:
        HTTPError: the server refuses; the error is an answer, too.
        URLError: the server cannot be reached.
        HTTPException, OSError, ValueError: the connection broke off, or the address is none.
    """
    headers = {"User-Agent": "splatree", "Range": f"bytes={begin}-{end - 1}"}

    def ask() -> addinfourl:
        answer: addinfourl = _opener().open(Request(url, headers=headers), timeout=TIMEOUT_S)
        return answer

    return tried_again(ask)


def tried_again(ask: Callable[[], _Answer]) -> _Answer:
    """What ``ask`` gets from a server, which it asks again where the server is busy or the connection breaks off.

    A server that refuses connections or sends nothing is not asked again: it is not there. Nor is an address that is none.

    Raises:
        HTTPError, HTTPException, OSError: the last answer was of this kind, or the first one will not be another.
    """
    for wait_s in WAITS_S:
        try:
            return ask()
        except HTTPError as error:
            if error.code not in _BUSY:
                raise
            error.close()
        except (HTTPException, ConnectionError) as error:
            if isinstance(error, ConnectionRefusedError | InvalidURL):
                raise
        time.sleep(wait_s)
    return ask()


def reason_of(error: Exception) -> str:
    """Why there is no answer, in one line."""
    if isinstance(error, IncompleteRead):
        return f"the connection broke off after {len(error.partial):,} bytes, try again"
    if isinstance(error, HTTPError):
        return f"status {error.code}, {_one_line(error.reason)}"
    return _one_line(getattr(error, "reason", None) or error)


def _one_line(said: object) -> str:
    """The first line of what a library or a server says, without what a terminal would obey."""
    lines = [line for line in str(said).splitlines() if line.strip()]
    return (
        "".join(letter if letter.isprintable() else "?" for letter in lines[0].strip())
        if lines
        else type(said).__name__
    )


def close_connections() -> None:
    """Close the connections that wait, and look up proxies anew."""
    _keeping.close_idle()
    _opener.cache_clear()


@cache
def _opener() -> OpenerDirector:
    return build_opener(_keeping)


class _Keeping(HTTPHandler, HTTPSHandler):
    """Opens addresses over connections that it keeps."""

    def __init__(self) -> None:
        super().__init__()
        self._lock = threading.Lock()
        self._idle: dict[Hashable, list[tuple[float, HTTPConnection]]] = defaultdict(list)

    def do_open(self, http_class: Any, req: Request, **given: Any) -> addinfourl:  # type: ignore[override]
        """The answer to a request, with as many bytes as its range has, or those of an error."""
        behind: str | None = req._tunnel_host  # type: ignore[attr-defined]  # the server that a proxy leads to
        place = (os.getpid(), http_class, req.host, behind)  # a child that was forked has connections of its own
        headers = {name.title(): value for name, value in req.header_items()}
        to_proxy = {"Proxy-Authorization": headers.pop("Proxy-Authorization", "")} if behind else {}
        connection = self._take(place)
        answer = None if connection is None else _answer_if_open(connection, req.selector, headers)
        if connection is None or answer is None:
            connection = http_class(req.host, timeout=req.timeout, **given)
            if behind:
                connection.set_tunnel(behind, headers={name: value for name, value in to_proxy.items() if value})
            answer = _answer(connection, req.selector, headers)
        first, last = map(int, headers["Range"].removeprefix("bytes=").split("-"))
        most = max(last - first + 2, _LEAST_BYTES)
        try:
            data = answer.read(most)
            if answer.length and len(data) < most:
                raise IncompleteRead(data, answer.length)
        finally:
            if answer.isclosed() and not answer.will_close:
                self._keep(place, connection)
            else:
                connection.close()
        whole = addinfourl(io.BytesIO(data), answer.headers, req.full_url, answer.status)
        whole.msg = answer.reason  # type: ignore[attr-defined]  # which the other handlers look at
        return whole

    def _take(self, place: Hashable) -> HTTPConnection | None:
        """A connection that waits, the last that was used; None: there is none."""
        with self._lock:
            idle, now = self._idle[place], time.monotonic()
            while idle:
                since, connection = idle.pop()
                if now - since < IDLE_S:
                    return connection
                connection.close()
        return None

    def close_idle(self) -> None:
        """Close the connections that wait."""
        with self._lock:
            for idle in self._idle.values():
                while idle:
                    idle.pop()[1].close()

    def _keep(self, place: Hashable, connection: HTTPConnection) -> None:
        with self._lock:
            self._idle[place].append((time.monotonic(), connection))
            if len(self._idle[place]) > MOST_IDLE:
                self._idle[place].pop(0)[1].close()


_keeping = _Keeping()
atexit.register(_keeping.close_idle)


def _answer(connection: HTTPConnection, selector: str, headers: dict[str, str]) -> HTTPResponse:
    try:
        connection.request("GET", selector, headers=headers)
        return connection.getresponse()
    except BaseException:
        connection.close()
        raise


def _answer_if_open(connection: HTTPConnection, selector: str, headers: dict[str, str]) -> HTTPResponse | None:
    """The answer over a connection that was kept; None: the server has closed it meanwhile."""
    try:
        return _answer(connection, selector, headers)
    except TimeoutError:
        raise
    except (OSError, HTTPException):
        return None
