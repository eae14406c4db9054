"""3D Tiles 1.1 for CesiumJS: a tree of tiles, each a ``.glb`` of at most 32,768 Gaussians that its children replace.

A tile is a run of whole sibling subtrees, drawn by the finest cut of it that has at most ``tile_nodes`` nodes. Its children are
groups of these subtrees with a quarter of its leaves, until a tile holds its leaves themselves. So a tile and its children stand
for the same leaves, and whatever tiles a viewer takes is a cut of the tree.

The extent e of a cut is that of a node drawn three pixels large. Cesium refines a tile while it would look more than 16 pixels
wrong, so the geometric error is 16/3 e. Axes: the scene's (x right, y down, z forward) become (−x, −y, z) in glTF, and these
(x, −z, y) in a tile, whose z is up. Layout: docs/reference/formats/tiles3d.md.
"""

import json
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from splatree.constants import SIGMAS
from splatree.io.chunks import ROWS_PER_CHUNK, Chunks
from splatree.io.formats.glb.names import EXTENSION, SPZ_EXTENSION
from splatree.io.formats.glb.writer import write_tile
from splatree.io.memory import Scratch
from splatree.progress import task
from splatree.scene.gaussians import Gaussians
from splatree.scene.scene import Scene
from splatree.shapes import Array
from splatree.stream.boxes import box_around
from splatree.stream.chunks import count_leaves_before, divide
from splatree.stream.earth import ecef_from_enu
from splatree.stream.levels import cuts_of, intervals_of
from splatree.stream.options import StreamOptions
from splatree.stream.parts import Folder, digest_of
from splatree.stream.result import LevelWritten, Streamed
from splatree.stream.workers import affordable, in_order

__all__ = ["MANIFEST", "Tile", "tiles_of_tree", "write_tiles"]

MANIFEST = "tileset.json"

_ERROR_PER_EXTENT = 16 / 3
"""Cesium's 16 px of error for the 3 px that a node's extent is made for."""

_CHILDREN = 4
"""A tile is divided into groups of this share of its leaves."""


@dataclass(eq=False)
class Tile:
    """One tile; tiles are listed parents first."""

    depth: int
    """Edges from the root."""
    size: float
    """e: the largest extent of a merged node, world units; 0 if all rows are leaves."""
    rows: Array
    """Rows that are drawn, ascending."""
    children: list[int] = field(default_factory=list)
    """Places in the list."""


def tiles_of_tree(scene: Scene, tile_nodes: int, scratch: Scratch | None = None) -> list[Tile]:
    """The tiles of a scene with levels, parents first."""
    tree, scratch = scene.tree, scratch or Scratch.endless()
    leaves_before = count_leaves_before(tree, scratch)
    tiles: list[Tile] = []
    pending: list[tuple[int, int, Tile | None]] = [(0, len(tree), None)]
    while pending:
        begin, end, parent = pending.pop()
        num_leaves = int(leaves_before[end] - leaves_before[begin])
        limit = np.inf if parent is None else 0.99 * parent.size
        if num_leaves <= tile_nodes:
            numbers = np.arange(begin, end, dtype=np.int32)
            size, rows = 0.0, numbers[tree.subtree_end[begin:end] == numbers + 1]
        else:
            soon_gone = scratch.part(0.5)
            intervals = intervals_of(tree, span=(begin, end), scratch=soon_gone)
            sizes, counts = cuts_of(intervals, soon_gone)
            few = sizes[np.argmax(counts <= tile_nodes)] if (counts <= tile_nodes).any() else sizes[-1]
            size = min(float(few), limit)  # a child's error is less than its parent's
            rows = intervals.rows_at(size)
        tile = Tile(0 if parent is None else parent.depth + 1, size, rows)
        if parent is not None:
            parent.children.append(len(tiles))
        tiles.append(tile)
        if size > 0:
            most = max(num_leaves // _CHILDREN, tile_nodes // 2)
            runs, _ = divide(scene, leaves_before, (begin, end), most)
            pending += [(a, b, tile) for a, b in reversed(runs)]
    return tiles


def write_tiles(
    scene: Scene,
    output: Path,
    options: StreamOptions,
    scratch: Scratch,
    *,
    force: bool = False,
    threads: int = 0,
) -> Streamed:
    """Write a scene with levels as a folder of 3D Tiles.

    Raises:
        OutputError: the folder holds something else, or the disk fails.
    """
    tiles = tiles_of_tree(scene, options.tile_nodes, scratch.part(0.5))
    threads = affordable(threads, options.tile_nodes * scene.gaussians.row_bytes, scratch.part(0.5))
    with Folder(output, MANIFEST, force=force) as folder:
        names, own_boxes, num_there = [], [], 0
        with task(f"write {output.name}", sum(len(tile.rows) for tile in tiles)) as advance:
            write = partial(_write_tile, scene, folder)
            for (name, was_there, box), tile in zip(
                in_order(write, list(enumerate(tiles)), threads), tiles, strict=True
            ):
                names.append(name)
                own_boxes.append(box)
                num_there += was_there
                advance(len(tile.rows))
        boxes = np.array(own_boxes)
        for index in range(len(tiles) - 1, -1, -1):  # children come after their parent
            for child in tiles[index].children:
                boxes[index, 0] = np.minimum(boxes[index, 0], boxes[child, 0])
                boxes[index, 1] = np.maximum(boxes[index, 1], boxes[child, 1])
        folder.finish(json.dumps(_manifest(tiles, names, boxes, options), separators=(",", ":")), names)
    return _result(output, folder, tiles, names, num_there)


def _write_tile(scene: Scene, folder: Folder, numbered: tuple[int, Tile]) -> tuple[str, bool, Array]:
    number, tile = numbered
    g = scene.gaussians.take(tile.rows)
    made_from = f"{tile.depth}_{number}-{digest_of(g, scene.mode, 'tile')}"
    name = folder.find(made_from)
    was_there = name is not None
    if name is None:

        def make() -> Iterator[Gaussians]:
            return (g.rows(begin, begin + ROWS_PER_CHUNK) for begin in range(0, len(g), ROWS_PER_CHUNK))

        name = folder.make(made_from, partial(write_tile, Chunks(len(g), g.sh_degree, scene.mode, make)), ".glb")
    return name, was_there, box_around(g, np.zeros(1, np.int64), sigmas=SIGMAS)[0]


def _manifest(tiles: list[Tile], names: list[str], boxes: Array, options: StreamOptions) -> dict[str, Any]:
    nodes: list[dict[str, Any]] = [{} for _ in tiles]
    for index in range(len(tiles) - 1, -1, -1):
        tile = tiles[index]
        nodes[index] = {
            "boundingVolume": {"box": _tile_box(boxes[index])},
            "geometricError": _ERROR_PER_EXTENT * tile.size,
            "refine": "REPLACE",
            "content": {"uri": names[index]},
        }
        if tile.children:
            nodes[index]["children"] = [nodes[child] for child in tile.children]
    diagonal = float(np.linalg.norm(boxes[0, 1] - boxes[0, 0]))
    origin = options.origin or (0.0, 0.0, 0.0)
    nodes[0]["transform"] = ecef_from_enu(*origin).T.ravel().tolist()
    used = [EXTENSION, SPZ_EXTENSION]
    return {
        "asset": {"version": "1.1", "generator": "splatree"},
        "extensionsUsed": ["3DTILES_content_gltf"],
        "extensions": {"3DTILES_content_gltf": {"extensionsUsed": used, "extensionsRequired": used}},
        "geometricError": max(2 * nodes[0]["geometricError"], diagonal),
        "root": nodes[0],
    }


def _tile_box(box: Array) -> list[float]:
    """Centre and half axes of a box, in the axes of a tile."""
    x, y, z = ((box[0] + box[1]) / 2).tolist()
    a, b, c = ((box[1] - box[0]) / 2).tolist()
    return [-x, -z, -y, a, 0.0, 0.0, 0.0, c, 0.0, 0.0, 0.0, b]


def _result(output: Path, folder: Folder, tiles: list[Tile], names: list[str], num_there: int) -> Streamed:
    sizes = [folder.part_bytes(name) for name in names]
    levels = []
    for level, depth in enumerate(range(max(tile.depth for tile in tiles), -1, -1)):
        own = [i for i, tile in enumerate(tiles) if tile.depth == depth]
        levels.append(
            LevelWritten(
                level,
                sum(len(tiles[i].rows) for i in own),
                max(tiles[i].size for i in own),
                len(own),
                sum(sizes[i] for i in own),
            )
        )
    total = sum(sizes) + (output / MANIFEST).stat().st_size
    return Streamed(output, "3dtiles", len(tiles), tuple(levels), len(tiles), num_there, len(folder.damaged), total)
