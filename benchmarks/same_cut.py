"""The three schemes of selection find the same rows: every view of every real scene, at several sizes and radii, bit for bit.

By blocks (ours), level by level (LoG), with a table of ancestors (FilterGS §3.2); stops at the first difference.
Run: python benchmarks/same_cut.py [city.splatree]      (without a file the city's tree is built first: a minute)
"""

import sys
from collections.abc import Iterator
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np

from harness import DATA, save, table
from splatree import PathOptions, Scene, SelectOptions, build_lod, flyout, orbit, read, read_cameras, select
from splatree.kernels.cpu.frame import select as cpu
from splatree.lod.serial import child_table_of, select_serial
from splatree.scene.cameras import Camera
from splatree.scene.view import view_of

PIXEL_ERRORS = (2.0, 3.0, 12.0)
PROFILES = ("exact", "3dgs", "ref", "sphere")
MADE = PathOptions(views=8, width=640, height=360)


def main() -> None:
    if not DATA.exists():
        sys.exit(f"same_cut: {DATA} is not there; this benchmark needs the shared scenes")
    rows = [row(name, scene, views) for name, scene, views in scenes()]
    print(table(rows))
    about = "Selections by blocks, by traversal and by a table of ancestors compared row for row; any difference would stop this."
    save("same_cut", rows, about=about)


def scenes() -> Iterator[tuple[str, Scene, list[Camera]]]:
    city = read(sys.argv[1]) if len(sys.argv) > 1 else build_lod(read(DATA / "trained" / "semarang_city"))
    yield "semarang_city", city, list(read_cameras(DATA / "cameras" / "semarang_city_made_views.json"))
    for name in (
        "trained/playcanvas_logo",
        "trained/playbot",
        "formats/biker_v4.spz",
        "formats/semarang_block/block_inria.ply",
    ):
        scene = build_lod(read(DATA / name))
        yield Path(name).name, scene, [*orbit(scene, MADE), *flyout(scene, MADE)]


def row(name: str, scene: Scene, views: list[Camera]) -> dict[str, object]:
    table, ancestors = child_table_of(scene.tree), cpu.ancestor_table(scene.tree)
    drawn = compared = 0
    for camera, pixel_error, profile in product(views, PIXEL_ERRORS, PROFILES):
        if len(scene) > 1_000_000 and (profile, pixel_error) not in (("exact", 3.0), ("sphere", 12.0)):
            continue
        options = replace(SelectOptions(), pixel_error=pixel_error, profile=profile)
        view = view_of(scene, camera)
        blocks = select(scene, view, options).rows
        serial, _ = select_serial(scene.gaussians, scene.tree, None, view, options, table=table)
        table, _ = cpu.select_by_ancestors(scene.gaussians, scene.tree, ancestors, view, options)
        for other, scheme in ((serial, "level by level"), (table, "table of ancestors")):
            if not np.array_equal(blocks, other):
                sys.exit(f"same_cut: {name}, {camera.name}, {options}: blocks and {scheme} differ")
        drawn, compared = drawn + len(blocks), compared + 1
    return {
        "scene": name,
        "nodes": len(scene),
        "views": len(views),
        "selections compared": compared,
        "rows drawn": drawn,
    }


if __name__ == "__main__":
    main()
