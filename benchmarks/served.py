"""What drawing a scene of a server takes: requests, connections, bytes, and processor time.

``python benchmarks/served.py [--chunks 3] [--folder /tmp]`` needs the shared city. A folder of parts of some chunks of it lies
behind a server of this machine, which counts. `render` draws views from near to far, each by a store that was just opened,
640 × 360. Requests and connections do not depend on what else the machine does.
"""

import argparse
import re
import tempfile
import threading
import time
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import numpy as np

import splatree as st
from harness import DATA, save, table

DISTANCES = (0.2, 0.5, 1.0, 3.0)
"""Of the camera from the middle of the scene, radii."""


class Counting(SimpleHTTPRequestHandler):
    """Gives ranges of files, and counts."""

    protocol_version = "HTTP/1.1"
    disable_nagle_algorithm = True
    counts: dict[str, int]

    def setup(self) -> None:
        super().setup()
        self.counts["connections"] += 1

    def do_GET(self) -> None:
        asked = re.fullmatch(r"bytes=(\d+)-(\d+)", self.headers["Range"])
        path = Path(self.translate_path(self.path))
        if asked is None or not path.is_file():
            self.send_error(404)
            return
        size, first = path.stat().st_size, int(asked[1])
        with path.open("rb") as file:
            file.seek(first)
            data = file.read(int(asked[2]) + 1 - first)
        self.send_response(206)
        self.send_header("Content-Range", f"bytes {first}-{first + len(data) - 1}/{size}")
        self.send_header("Content-Length", str(len(data)))
        self.end_headers()
        self.wfile.write(data)
        self.counts["requests"] += 1
        self.counts["bytes"] += len(data)

    def log_message(self, *_: object) -> None:
        pass


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--chunks", type=int, default=3)
    parser.add_argument("--store", type=Path, help="a folder of parts that is there, in place of chunks")
    parser.add_argument("--folder", type=Path, default=Path(tempfile.gettempdir()))
    arguments = parser.parse_args()
    city = DATA / "trained" / "semarang_city"
    chunks = sorted(path for path in city.iterdir() if path.is_dir())[: arguments.chunks]
    counts = {"requests": 0, "connections": 0, "bytes": 0}
    with tempfile.TemporaryDirectory(dir=arguments.folder) as name:
        path = arguments.store
        if path is None:
            st.convert(chunks, Path(name) / "city.ply")
            options, path = st.BuildOptions(method="radius"), Path(name) / "city.splatree"
            st.build_folder(Path(name) / "city.ply", path, options)
        handler = partial(type("Handler", (Counting,), {"counts": counts}), directory=str(path.parent))
        with ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
            threading.Thread(target=server.serve_forever, daemon=True).start()
            rows = drawn(f"http://127.0.0.1:{server.server_port}/{path.name}", counts)
            server.shutdown()
    print(table(rows))
    save("served", rows, about="What drawing a scene of a server takes, by the distance of the camera")


def drawn(address: str, counts: dict[str, int]) -> list[dict[str, object]]:
    """A row for each view."""
    rows = []
    for distance in DISTANCES:
        before, start = dict(counts), time.process_time()
        with st.open_store(address) as store:
            opened = counts["requests"] - before["requests"]
            framing = st.frame_scene(store.sample())
            sampled = counts["requests"] - before["requests"] - opened
            centre, radius = framing.centre, framing.radius
            eye = centre + np.asarray(framing.up) * 0.5 * distance * radius + np.array([distance * radius, 0, 0])
            camera = st.Camera.look_at(eye, centre, width=640, height=360, fov_y_deg=60.0)
            selection = store.select(camera)
            st.render(store, camera)
            loaded, pages = store.num_loaded, len(store.index.table)
        rows.append(
            {
                "nodes": len(store),
                "files": len(store.index.file_start) - 1,
                "distance, radii": distance,
                "drawn": len(selection),
                "pages read": loaded,
                "of pages": pages,
                "requests to open": opened,
                "requests to draw": counts["requests"] - before["requests"] - opened - sampled,
                "connections": counts["connections"] - before["connections"],
                "MB": (counts["bytes"] - before["bytes"]) / 1e6,
                "CPU s, server too": time.process_time() - start,
            }
        )
        print(rows[-1], flush=True)
    return rows


if __name__ == "__main__":
    main()
