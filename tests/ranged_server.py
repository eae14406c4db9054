"""A server of files on this machine that gives ranges of bytes, or does what servers should not."""

import re
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import ClassVar
from unittest import mock

from splatree.io import http


class Ranges(SimpleHTTPRequestHandler):
    """Answers with ranges; counts their bytes in ``sent``, and connections in ``opened``."""

    protocol_version = "HTTP/1.1"  # connections stay open
    disable_nagle_algorithm = True  # heads and bodies are sent apart: 40 ms for each request otherwise
    sent: list[int]
    opened: list[object]
    cut = False
    """Whether it gives fewer bytes than it was asked for, as of an object that has been replaced."""
    range_says = "bytes {first}-{last}/{size}"
    """What it says of a range."""

    def setup(self) -> None:
        super().setup()
        self.opened.append(self.client_address)

    def do_GET(self) -> None:
        path = Path(self.translate_path(self.path))
        asked = re.fullmatch(r"bytes=(\d+)-(\d+)", self.headers.get("Range", ""))
        if asked is None or not path.is_file():
            super().do_GET()
            return
        data = path.read_bytes()
        first, last = int(asked[1]), min(int(asked[2]), len(data) - 1)
        part = data[first : last + 1 - (self.cut and last > first)]
        if first >= len(data):
            self.send_error(416)
            return
        self.send_response(206)
        self.send_header("Content-Range", self.range_says.format(first=first, last=last, size=len(data)))
        self.send_header("Content-Length", str(len(part)))
        self.end_headers()
        self.wfile.write(part)
        self.sent.append(len(part))

    def log_message(self, *_: object) -> None:
        pass


class Cutting(Ranges):
    """Gives a byte less than it is asked for."""

    cut = True


class Unsaid(Ranges):
    """Does not say how large a file is."""

    range_says = "bytes {first}-{last}/*"


class Sizeless(SimpleHTTPRequestHandler):
    """Gives files in chunks, without their size and without ranges."""

    protocol_version = "HTTP/1.1"

    def do_GET(self) -> None:
        path = Path(self.translate_path(self.path))
        if not path.is_file():
            self.send_error(404)
            return
        self.send_response(200)
        self.send_header("Transfer-Encoding", "chunked")
        self.end_headers()
        data = path.read_bytes()
        self.wfile.write(b"%x\r\n%b\r\n0\r\n\r\n" % (len(data), data))

    def log_message(self, *_: object) -> None:
        pass


class Shifted(Ranges):
    """Says that it gives another range than it was asked for."""

    range_says = "bytes 7{first}-7{last}/{size}"


class Closing(Ranges):
    """Closes each connection after an answer, and does not tell."""

    def do_GET(self) -> None:
        super().do_GET()
        self.close_connection = True


class Leading(Ranges):
    """Leads each address to another."""

    def do_GET(self) -> None:
        if self.path.startswith("/old"):
            self.send_response(302)
            self.send_header("Location", self.path.replace("/old", ""))
            self.send_header("Content-Length", "0")
            self.end_headers()
        else:
            super().do_GET()


class Proxy(Ranges):
    """Is asked for addresses of other servers."""

    def do_GET(self) -> None:
        if self.headers["Host"] == "elsewhere.invalid" and self.headers["Proxy-Authorization"] == "Basic dTpw":
            self.path = self.path.removeprefix("http://elsewhere.invalid")
            super().do_GET()
        else:
            self.send_error(407)


class Busy(Ranges):
    """Gives half an answer, then a page that says it is busy, then what it was asked for, and so on."""

    asked = 0

    def do_GET(self) -> None:
        type(self).asked += 1
        if type(self).asked % 3 == 2:
            self.send_error(503)
        elif type(self).asked % 3 == 1:
            self.send_response(206)
            self.send_header("Content-Range", "bytes 0-99/100")
            self.send_header("Content-Length", "100")
            self.end_headers()
            self.wfile.write(b"half")
            self.close_connection = True
        else:
            super().do_GET()


class Down(Ranges):
    """Is always busy."""

    def do_GET(self) -> None:
        self.sent.append(0)
        self.send_error(503)


class Stamped(Ranges):
    """Says of which state of a file its answers are."""

    is_replaced = False
    """Whether it is the second state."""
    changes: ClassVar = {"ETag", "Last-Modified"}
    """Which stamps the other state has."""

    def end_headers(self) -> None:
        for name in ("ETag", "Last-Modified"):
            self.send_header(name, f'"{name} {self.is_replaced and name in self.changes}"')
        super().end_headers()


class Mirrored(Stamped):
    """Is one of two machines with the same files, each of which makes up its own ETags."""

    changes: ClassVar = {"ETag"}


class Forbidding(Ranges):
    """Says "forbidden" of what is not there, as buckets do whose names may not be listed."""

    def do_GET(self) -> None:
        if Path(self.translate_path(self.path)).is_file():
            super().do_GET()
        else:
            self.send_error(403)


class Unpacked(SimpleHTTPRequestHandler):
    """Says that a file is packed which is not."""

    def end_headers(self) -> None:
        self.send_header("Content-Encoding", "gzip")
        super().end_headers()

    def log_message(self, *_: object) -> None:
        pass


class Refusing(Ranges):
    """Has nothing, and says so on a page."""

    def do_GET(self) -> None:
        self.send_response(404)
        self.send_header("Content-Length", "1000")
        self.end_headers()
        self.wfile.write(bytes(1000))


class _Server(ThreadingHTTPServer):
    def handle_error(self, *_: object) -> None:
        """A connection that was closed on either side."""


@dataclass
class Served:
    """A folder that a server gives."""

    address: str = ""
    """Where it is."""
    sent: list[int] = field(default_factory=list)
    """Bytes of each range that was sent."""
    opened: list[object] = field(default_factory=list)
    """Connections that were opened."""


@contextmanager
def served(folder: Path, handler: type[SimpleHTTPRequestHandler] = Ranges) -> Iterator[Served]:
    """A folder, served while the context lasts."""
    found = Served()
    counting = type("Counting", (handler,), {"sent": found.sent, "opened": found.opened})
    with (
        mock.patch.object(http, "WAITS_S", (0.0, 0.0)),
        _Server(("127.0.0.1", 0), partial(counting, directory=str(folder))) as server,
    ):
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        try:
            found.address = f"http://127.0.0.1:{server.server_port}"
            yield found
        finally:
            http.close_connections()
            server.shutdown()
            thread.join()
