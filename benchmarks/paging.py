"""What drawing from disk reads and costs, beside drawing from memory, and that both draw the same picture.

``python benchmarks/paging.py [--chunks 10] [--store a.splatree b.splatree] [--memory 500M] [--views 15 12 6 0]`` needs the shared
city. A folder is built by a radius unless folders are named. For each view the store is opened anew. *Touched* are the 4,096-byte
pages of the files that hold what is looked at: of each page that is loaded all columns that a selection reads, the others
(harmonics, and how nodes follow the pixel) of 64 rows of which one is drawn, and the index. *Whole pages* are the store's pages
that a drawn row is in, as a server would have to send them.
"""

import argparse
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

import splatree as st
from harness import DATA, save, table
from splatree.io.cameras.files import read_cameras
from splatree.io.pages.page import DRAWN_ROWS
from splatree.io.pages.table import row_bytes_of

SYSTEM_PAGE = 4096
DRAWN = {"gaussians.sh", "tree.curves"}
"""What drawing alone reads."""
VIEWS = DATA / "cameras" / "semarang_city_made_views.json"


def touched_bytes(store: st.Store) -> int:
    """Bytes of the pages of memory that hold what was looked at."""
    found: dict[int, list[np.ndarray]] = {}

    def touch(number: int, name: str, begin: int, end: int) -> None:
        column = store._files[number].file.columns[name]
        first, last = (column.start + row * column.bytes_per_row for row in (begin, end))
        found.setdefault(number, []).append(np.arange(first // SYSTEM_PAGE, -(-last // SYSTEM_PAGE)))

    for number, page in store._pages.items():
        file = store.index.file_of(number)
        stored = store._files[file]
        for name, column in stored.file.columns.items():
            # Parts also hold how their roots grew, which no view looks at.
            if name not in DRAWN and column.shape[0] == len(stored):
                touch(file, name, page.begin, page.begin + len(page))
        for block in np.flatnonzero(page.is_checked):
            begin = page.begin + int(block) * DRAWN_ROWS
            for name in DRAWN & stored.file.columns.keys():
                touch(file, name, begin, min(begin + DRAWN_ROWS, page.begin + len(page)))
    pages = sum(len(np.unique(np.concatenate(runs))) for runs in found.values())
    return SYSTEM_PAGE * pages + store.index.nbytes


def cpu_seconds(work: Callable[[], object]) -> float:
    """Processor seconds of the second of two runs: the first one loads pages."""
    work()
    began = time.process_time()
    work()
    return time.process_time() - began


def row_of(folder: Path, scene: st.Scene, view: int, camera: st.Camera, memory: str) -> dict[str, object]:
    """One view, from a store that is opened anew and from memory."""
    began = time.process_time()
    with st.open_store(folder, max_memory="64G") as store, st.open_session(store) as session:
        frame = session.trace(camera)
        first, num_loaded = time.process_time() - began, store.num_loaded
        cut = store.cut(camera)[1]
        drawn = len(cut) * row_bytes_of(store._files[0].head)
        index = store.index.table
        pages = np.unique(cut.pages)
        whole = int((index.end - index.begin)[pages].sum()) * row_bytes_of(store._files[0].head)
        touched = touched_bytes(store)
    with st.open_store(folder, max_memory=memory) as store, st.open_session(store) as session:
        from_disk = cpu_seconds(lambda: session.draw(camera))
    with st.open_session(scene) as session:
        wanted = session.trace(camera)
        from_memory = cpu_seconds(lambda: session.draw(camera))
    is_same = np.array_equal(frame.selection.rows, wanted.selection.rows) and (
        frame.result.image.tobytes() == wanted.result.image.tobytes()
    )
    return {
        "levels": "" if scene.tree.record is None else scene.tree.record.rule,
        "view": view,
        "pages read": f"{num_loaded} of {len(index)}",
        "drawn MB": drawn / 1e6,
        "touched / drawn": touched / drawn,
        "whole pages / drawn": whole / drawn,
        "first picture CPU s": first,
        f"CPU / in memory ({memory})": from_disk / from_memory,
        "same picture": "yes" if is_same else "no",
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--chunks", type=int, default=10, help="chunks of the city, at most 10")
    parser.add_argument("--store", type=Path, nargs="+", help="folders of parts of the city; without any, one is built")
    parser.add_argument("--memory", default="500M")
    parser.add_argument("--views", type=int, nargs="+", default=[15, 12, 6, 0])
    parser.add_argument("--folder", type=Path, default=Path(tempfile.gettempdir()))
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory(dir=arguments.folder) as name:
        stores = arguments.store
        if stores is None:
            stores, ply = [Path(name) / "city.splatree"], Path(name) / "city.ply"
            city = DATA / "trained" / "semarang_city"
            st.convert(sorted(path for path in city.iterdir() if path.is_dir())[: arguments.chunks], ply)
            st.build_folder(ply, stores[0], st.BuildOptions("radius"))
        cameras, rows, whole = list(read_cameras(VIEWS)), list[dict[str, object]](), Path(name) / "whole.splatree"
        for store in stores:
            st.write(st.read(store), whole, force=True)
            scene = st.read(whole)
            for view in arguments.views:
                row = row_of(store, scene, view, cameras[view], arguments.memory)
                rows.append({"Gaussians": scene.tree.num_leaves, **row})
                print(table(rows), flush=True)
    save("paging", rows, about="Drawing the real city from disk, beside drawing it from memory")


if __name__ == "__main__":
    main()
