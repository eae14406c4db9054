"""Selection on a real city: CPU-ms of the exact visible cut by blocks, beside the serial traversal and FilterGS's own scheme.

The tree is that of the whole semarang_city, twice side by side, so that it has more than 8 M nodes whatever the levels. All
four find the same rows bit for bit, which is checked; all use the same compiled radius and view test on one thread:

blocks   kernels/cpu/select: work follows the blocks that can be seen
serial   lod/serial: from the roots down, level by level, with a table of children (12 bytes a node) made beforehand
filtergs as published: one pass over all rows with a table of the ancestors of each (4 bytes a row and level, made beforehand)
flat     radius of every row with children, one prefix maximum over all rows, the view test of the cut

Run: python benchmarks/selection.py [scene.splatree]      (without a file the tree is built first: a minute of processor time)
"""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

from harness import DATA, measure, save, table
from splatree import Camera, Gaussians, GaussianTree, Scene, SelectOptions, build_lod, read, read_cameras, select
from splatree.kernels.cpu.frame import select as cpu
from splatree.lod.baselines import Baseline, BaselineOptions, baseline
from splatree.lod.blocks import with_blocks
from splatree.lod.serial import child_table_of, select_serial
from splatree.scene.view import View, view_of

CITY = DATA / "trained" / "semarang_city"
VIEWS = DATA / "cameras" / "semarang_city_made_views.json"
COPIES = 2
OFFSET = 1100.0
"""Metres between the copies: about the width of the city."""
REPEAT = 7
"""Runs of each, of which the cheapest counts: other work on the machine disturbs caches and memory, which are the limit."""


def main() -> None:
    if not VIEWS.exists():
        sys.exit(f"selection: {DATA} is not there; this benchmark needs the shared scenes")
    scene = load(Path(sys.argv[1]) if len(sys.argv) > 1 else None)
    index = measure(lambda: with_blocks(replace(scene, blocks=None), threads=1))
    scene, table = index.value, child_table_of(scene.tree)
    ancestors = measure(lambda: baseline("filtergs", scene, options=BaselineOptions(SelectOptions().pixel_error)))
    filtergs = ancestors.value
    n = len(scene)
    index_bytes = scene.blocks.nbytes / n
    print(
        f"{n:,} nodes, {scene.tree.num_leaves:,} leaves; bytes a node: subtree_end 4, block index {index_bytes:.2f}, "
        f"table of children of the serial traversal 12, table of ancestors {filtergs.num_bytes / n:.0f} "
        f"(FilterGS); index made in {1e3 * index.cpu_s:.0f} CPU-ms, table of ancestors in {1e3 * ancestors.cpu_s:.0f}\n"
    )
    rows = [row(scene, levels, filtergs, camera) for camera in views()]
    print(table(rows))
    slope = np.polyfit(*np.log([[r[key] for r in rows] for key in ("visited", "blocks CPU-ms")]), 1)[0]
    print(f"\nslope of CPU-ms over rows visited (log-log): {slope:.2f}")
    save(
        "selection",
        rows,
        about=f"Exact cut and culling at 3 px on {n:,} nodes of a real city, one thread, {index_bytes:.2f} bytes of index a "
        f"node; CPU-ms of the compiled blocks, of the traversal level by level, of FilterGS's pass over all rows with a table of "
        f"{filtergs.num_bytes / n:.0f} bytes a node, and of a prefix maximum over all rows.",
    )


def load(path: Path | None) -> Scene:
    """The city's tree, without harmonics above DC, repeated along x."""
    if path is None:
        flat = read(CITY)
        one = build_lod(replace(flat, gaussians=flat.gaussians.with_sh_degree(0)))
    else:
        one = read(path)
    gaussians, tree = one.gaussians.with_sh_degree(0), one.tree
    shifts = [np.float32([OFFSET * copy, 0, 0]) for copy in range(COPIES)]
    parts = [replace(gaussians, means=gaussians.means + shift) for shift in shifts]
    ends = [tree.subtree_end + np.int32(copy * len(tree)) for copy in range(COPIES)]
    columns = (np.tile(column, COPIES) for column in (tree.depth, tree.extents))
    return Scene(Gaussians.concatenate(parts), GaussianTree(np.concatenate(ends), *columns))


def views() -> list[Camera]:
    """A descent towards the city, a look from its midst, and one that holds all of it."""
    named = {camera.name: camera for camera in read_cameras(VIEWS)}
    return [named[f"flight_{i:02}"] for i in (0, 3, 6, 9, 12, 15)] + [named["orbit_05"], named["far_02"]]


def row(scene: Scene, levels: object, filtergs: Baseline, camera: Camera) -> dict[str, object]:
    """Costs of the three for one view."""
    options = SelectOptions()
    blocks = measure(lambda: select(scene, camera, options, threads=1), repeat=REPEAT)
    view = view_of(scene, camera)
    serial = measure(
        lambda: select_serial(scene.gaussians, scene.tree, None, view, options, table=table, threads=1),
        repeat=REPEAT,
    )
    flat = measure(lambda: select_flat(scene, view, options), repeat=REPEAT)
    theirs = measure(lambda: filtergs(view, threads=1), repeat=REPEAT)
    rows, visited = serial.value
    assert np.array_equal(rows, theirs.value.rows)
    assert np.array_equal(rows, blocks.value.rows)
    assert np.array_equal(rows, flat.value)
    return {
        "view": camera.name,
        "drawn": len(blocks.value),
        "drawn %": 100 * len(blocks.value) / len(scene),
        "visited": blocks.value.num_visited,
        "blocks CPU-ms": 1e3 * blocks.cpu_s,
        "ns a visited row": 1e9 * blocks.cpu_s / max(blocks.value.num_visited, 1),
        "serial CPU-ms": 1e3 * serial.cpu_s,
        "serial visits": visited,
        "filtergs CPU-ms": 1e3 * theirs.cpu_s,
        "flat CPU-ms": 1e3 * flat.cpu_s,
        "serial / blocks": serial.cpu_s / blocks.cpu_s,
        "filtergs / blocks": theirs.cpu_s / blocks.cpu_s,
        "flat / blocks": flat.cpu_s / blocks.cpu_s,
    }


def select_flat(scene: Scene, view: View, options: SelectOptions) -> np.ndarray:
    """The visible cut with all rows at once."""
    gaussians, tree = scene.gaussians, scene.tree
    leaf = tree.is_leaf
    inner = np.flatnonzero(~leaf).astype(np.int32)
    small = inner[cpu.small(gaussians, tree, inner, view, options, threads=1)]
    reach = np.zeros(len(tree) + 1, np.int32)
    reach[small + 1] = tree.subtree_end[small]  # of the rows before each row
    leaf[small] = True
    cut = np.flatnonzero(leaf & (np.maximum.accumulate(reach)[:-1] <= np.arange(len(tree)))).astype(np.int32)
    return cut[cpu.visible(gaussians, tree, cut, view, options, threads=1)]


if __name__ == "__main__":
    main()
