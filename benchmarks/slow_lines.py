"""The viewer over slow lines: seconds and bytes until there is a picture, until it is sharp, and after the camera jumps.

``python benchmarks/slow_lines.py [SCENE] [--rates 1000000 200000] [--budget 300000]`` needs a scene with levels; without one it
builds those of a chunk of the shared city. The server of `splatree view` runs in this process. A page that does what a browser
does (it asks for cuts and acknowledges them, but does not draw) reaches it through a socket that hands on so many bytes a second
and keeps back the rest.

- *opened*: the files of the page, then the first view.
- *turned by 20°*, *turned by 90°, nearer*: another view, once the last one is sharp.
- *jumped while loading*: another view after the first picture of a page that has just been opened.

A picture is there with the first cut of the newest view. It is sharp with the last nodes of that view, and done with the last
colours of nodes that were there before. Loads of the processor and the way to a page far away are not in it.
"""

import argparse
import json
import socket
import struct
import threading
import time
import urllib.request
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
from websockets.sync.client import connect

import splatree
from harness import DATA, save, table
from splatree.view.files import page_files

CHUNK = DATA / "trained" / "semarang_city" / "5_1"
WIDTH, HEIGHT, GUARD = 960, 540, 0.08
RATES = (1_000_000, 200_000)
PIECE, BUFFER = 4_096, 16_384
PATIENCE_S = 300.0


class Line:
    """A socket of this machine that hands on so many bytes a second of what a server says."""

    def __init__(self, port: int, rate: float) -> None:
        self._server_port, self._rate = port, rate
        self._free_at = 0.0
        self._lock = threading.Lock()
        self._listening = socket.create_server(("127.0.0.1", 0))
        self.port: int = self._listening.getsockname()[1]
        threading.Thread(target=self._accept, daemon=True).start()

    def close(self) -> None:
        """Take no more connections."""
        self._listening.close()

    def _accept(self) -> None:
        while True:
            try:
                page, _ = self._listening.accept()
            except OSError:
                return
            server = socket.socket()
            server.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, BUFFER)
            server.connect(("127.0.0.1", self._server_port))
            for one, other, is_slow in ((page, server, False), (server, page, True)):
                threading.Thread(target=self._hand_on, args=(one, other, is_slow), daemon=True).start()

    def _hand_on(self, one: socket.socket, other: socket.socket, is_slow: bool) -> None:
        try:
            while data := one.recv(PIECE):
                if is_slow:
                    with self._lock:  # all connections share the line
                        self._free_at = max(self._free_at, time.monotonic()) + len(data) / self._rate
                        until = self._free_at
                    time.sleep(max(0.0, until - time.monotonic()))
                other.sendall(data)
            other.shutdown(socket.SHUT_WR)
        except OSError:
            other.close()


class Page:
    """What a browser's page says and takes in."""

    def __init__(self, port: int, budget: int) -> None:
        self.num_bytes, self._budget, self._num_taken, self._seq = 0, budget, 0, 0
        self.opened = time.monotonic()
        for name in ("", *(f"page/{name}" for name in page_files() if name != "index.html")):
            with urllib.request.urlopen(f"http://127.0.0.1:{port}/{name}") as file:
                self.num_bytes += len(file.read())
        self._left = ExitStack()
        address = f"ws://127.0.0.1:{port}/ws?scene=0"
        self._socket = self._left.enter_context(connect(address, max_size=None, compression=None))
        self.facts = self._next()

    def close(self) -> None:
        """Leave."""
        self._left.close()

    def ask(self, camera: splatree.Camera, centre: np.ndarray) -> None:
        """Want another view."""
        self._seq += 1
        pose = np.linalg.inv(camera.camera_from_world)
        pose[:3, 3] -= centre
        view = {
            "want": "cut",
            "seq": self._seq,
            "c2w": pose[:3].ravel().tolist(),
            "f": camera.K[1, 1],
            "w": WIDTH,
            "h": HEIGHT,
        }
        view |= {"near": camera.near, "tau": 1.0, "budget": self._budget, "guard": GUARD}
        self._socket.send(json.dumps(view))

    def wait(self, began: float, *, for_last: bool, sharp: dict[str, Any] | None = None) -> dict[str, Any]:
        """What it takes until a cut of the newest view is there, or the last of them; ``sharp`` is what brought nodes before."""
        while True:
            header = self._next()
            if header["kind"] != "cut":
                continue
            self._num_taken += 1
            self._socket.send(json.dumps({"ack": self._num_taken}))
            if header["seq"] == self._seq:
                now = {"s": time.monotonic() - began, "bytes": self.num_bytes, "nodes": header["rows"]}
                if header["add"] or sharp is None:
                    sharp = now
                if header["last"] or not for_last:
                    return {"sharp": sharp, "done": now, "is_last": header["last"]}

    def _next(self) -> dict[str, Any]:
        data = self._socket.recv(PATIENCE_S)
        assert isinstance(data, bytes)
        self.num_bytes += len(data)
        (length,) = struct.unpack("<I", data[:4])
        header: dict[str, Any] = json.loads(data[4 : 4 + length])
        return header


def seen_from(viewer: splatree.Viewer, share: float, degrees: float) -> splatree.Camera:
    """The first view at a share of its distance, turned about the vertical through the centre of the scene."""
    framing = viewer._server.exhibits[0].framing
    offset, up, angle = (framing.eye - framing.target) * share, framing.up, np.radians(degrees)
    offset = offset * np.cos(angle) + np.cross(up, offset) * np.sin(angle) + up * (up @ offset) * (1 - np.cos(angle))
    made = splatree.Camera.look_at(
        framing.target + offset, framing.target, up=up, width=WIDTH, height=HEIGHT, fov_y_deg=framing.fov_y_deg
    )
    return made


def visits(viewer: splatree.Viewer, rate: float, budget: int) -> list[dict[str, Any]]:
    """What a page goes through on a line."""
    centre = viewer._server.exhibits[0].centre
    line, rows = Line(viewer.port, rate), []

    def look(
        page: Page, what: str, share: float, degrees: float, began: float | None = None, stays: bool = True
    ) -> None:
        began = time.monotonic() if began is None else began
        page.ask(seen_from(viewer, share, degrees), centre)
        before = page.num_bytes if what != "opened" else 0
        found = page.wait(began, for_last=False)
        steps = {"picture": found["sharp"]}
        if stays:
            if not found["is_last"]:
                found = page.wait(began, for_last=True, sharp=found["sharp"])
            steps |= {"sharp": found["sharp"], "done": found["done"]}
            row: dict[str, Any] = {"kB a second": rate / 1e3, "what": what}
            for name, step in steps.items():
                row |= {f"{name}, s": step["s"], f"{name}, MB": (step["bytes"] - before) / 1e6}
            rows.append(row | {"picture, nodes": steps["picture"]["nodes"], "done, nodes": steps["done"]["nodes"]})
            print(rows[-1], flush=True)

    page = Page(line.port, budget)
    look(page, "opened", 1.0, 0.0, page.opened)
    look(page, "turned by 20°", 1.0, 20.0)
    look(page, "turned by 90°, nearer", 0.4, 110.0)
    page.close()
    page = Page(line.port, budget)
    look(page, "opened", 1.0, 0.0, page.opened, stays=False)
    time.sleep(1.0)
    look(page, "jumped while loading", 0.4, 110.0)
    page.close()
    line.close()
    return rows


def main() -> None:
    """Open pages and move their cameras."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", type=Path, nargs="?")
    parser.add_argument("--rates", type=float, nargs="+", default=RATES)
    parser.add_argument("--budget", type=int, default=300_000)
    arguments = parser.parse_args()
    scene = splatree.build_lod(splatree.read(CHUNK)) if arguments.scene is None else splatree.read(arguments.scene)
    rows: list[dict[str, Any]] = []
    with splatree.Viewer(scene) as viewer:
        for rate in arguments.rates:
            rows += visits(viewer, rate, arguments.budget)
    print(table(rows))
    save(
        "slow_lines",
        rows,
        about=f"A page over lines of so many kB a second: {scene.tree.num_leaves:,} leaves, a window of {WIDTH} × "
        f"{HEIGHT} px, at most {arguments.budget:,} nodes. Seconds by the clock from when the page is opened or the camera "
        "jumps, MB of all that the page takes in meanwhile",
    )


if __name__ == "__main__":
    main()
