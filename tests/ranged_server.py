"""A server of files on this machine that gives ranges of bytes, or does what servers should not."""

import re
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path


class Ranges(SimpleHTTPRequestHandler):
    """Answers with ranges; counts their bytes in ``sent``."""

    disable_nagle_algorithm = True  # heads and bodies are sent apart: 40 ms for each request otherwise
    sent: list[int]
    cut = False
    """Whether it gives fewer bytes than it was asked for, as of an object that has been replaced."""

    def do_GET(self) -> None:
        path = Path(self.translate_path(self.path))
        asked = re.fullmatch(r"bytes=(\d+)-(\d+)", self.headers.get("Range", ""))
        if asked is None or not path.is_file():
            super().do_GET()
            return
        data = path.read_bytes()
        first, last = int(asked[1]), min(int(asked[2]), len(data) - 1)
        part = data[first : last + 1 - (self.cut and last > first)]
        if not data:
            self.send_error(416)
            return
        self.send_response(206)
        self.send_header("Content-Range", f"bytes {first}-{last}/{len(data)}")
        self.send_header("Content-Length", str(len(part)))
        self.end_headers()
        self.wfile.write(part)
        self.sent.append(len(part))

    def log_message(self, *_: object) -> None:
        pass


class Cutting(Ranges):
    """Gives a byte less than it is asked for."""

    cut = True


@contextmanager
def served(folder: Path, handler: type[SimpleHTTPRequestHandler] = Ranges) -> Iterator[tuple[str, list[int]]]:
    """The address of a folder, and the bytes of each range that was sent."""
    sent: list[int] = []
    counting = type("Counting", (handler,), {"sent": sent})
    with ThreadingHTTPServer(("127.0.0.1", 0), partial(counting, directory=str(folder))) as server:
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        try:
            yield f"http://127.0.0.1:{server.server_port}", sent
        finally:
            server.shutdown()
            thread.join()
