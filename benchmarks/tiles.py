"""What a picture asks of a GPU that blends it: how long the lists of its tiles are, and in which order to take them.

``python benchmarks/tiles.py [CITY.splatree]`` needs the shared city, as frames.py. No GPU: the lists are those of the processor,
which are the same. Of four views of the city, with all leaves and with a budget of nodes:

- *splats of one tile*, *their pairs*: shares of all splats, and of all pairs.
- *read*: entries that a tile's list is read for, in the mean, at most by 99 of 100 tiles, and at most by any.
- *row by row*, *longest first*: when the last of the tiles is done, over when all would be if work could be divided at will.
  Tiles are taken by 132 multiprocessors with four thread blocks of 256 threads each, one after the other; a tile takes as long
  as its list is read, and ``BEGIN`` entries more. `longest first` is by half octaves of the lists' lengths, as bin.cu does it.
"""

import argparse
import heapq
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

import splatree as st
from frames import BUDGET, CITY, CITY_VIEWS, LEAVES, VIEWS
from harness import save, table

SIZES = ((1080, LEAVES), (1080, st.SelectOptions(budget=BUDGET)), (720, st.SelectOptions(budget=BUDGET)))
THREAD_BLOCKS = 132 * 4
BEGIN = 20
"""Entries that could be read while a thread block begins and ends: a guess, of which the ratios hardly depend."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("city", type=Path, nargs="?")
    path = parser.parse_args().city
    if not (CITY.exists() and VIEWS.exists()):
        raise SystemExit(f"needs the city at {CITY} and its views at {VIEWS}")
    city = st.read(path) if path else st.build_lod(st.read(sorted(CITY.glob("5_*"))))
    rows = list(counts(city))
    print(table(rows))
    save(
        "tiles",
        rows,
        about=f"Lists of tiles of a city of {city.tree.num_leaves:,} leaves, and when {THREAD_BLOCKS} thread blocks at a time "
        "would have blended them, over the best that can be",
    )


def counts(city: st.Scene) -> Iterator[dict[str, Any]]:
    """A row a view, size and choice of nodes."""
    views = {camera.name: camera for camera in st.read_cameras(VIEWS)}
    for kind in ("far", "high", "orbit", "low"):
        for height, select in SIZES:
            camera = views[CITY_VIEWS[kind]]
            frame = st.trace(
                city, camera.scaled(height / camera.height), select=select, wanted=st.Wanted(last_pair=True)
            )
            tiles_of_splat = np.bincount(frame.bins.splat_from_pair, minlength=len(frame.splats))
            is_one = tiles_of_splat == 1
            read = frame.tiles.consumed.ravel().astype(np.float64)
            lengths = np.diff(frame.bins.tile_start)
            longest_first = np.argsort(-np.floor(2 * np.log2(np.maximum(lengths, 1))), kind="stable")
            work = read + BEGIN
            best = max(work.sum() / THREAD_BLOCKS, work.max())
            yield {
                "view": kind,
                "px": height,
                "drawn": "leaves" if select is LEAVES else f"{BUDGET:,} nodes",
                "pairs": frame.bins.num_pairs,
                "splats of one tile": float(is_one.sum() / (tiles_of_splat > 0).sum()),
                "their pairs": float(is_one.sum() / frame.bins.num_pairs),
                "read": read.mean(),
                "99 %": float(np.percentile(read, 99)),
                "most": int(read.max()),
                "row by row": end_of(work) / best,
                "longest first": end_of(work[longest_first]) / best,
            }


def end_of(work: np.ndarray) -> float:
    """When the last piece of work is done, if each is taken as soon as a thread block has room."""
    free = [0.0] * THREAD_BLOCKS
    for piece in work:
        heapq.heapreplace(free, free[0] + piece)
    return max(free)


if __name__ == "__main__":
    main()
