"""Streamed SOG: a manifest ``lod-meta.json``, and units, each a SOG of whole chunks of one level.

A viewer chooses a level for each chunk and loads the units that hold it; a unit has one level only, and the rows of its chunks
follow each other in it, each chunk's rows in the order of the tree. Units are small, so that few bytes are loaded that are
not shown. Layout: docs/reference/formats/streamed_sog.md.
"""

import json
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from splatree.io.chunks import ROWS_PER_CHUNK, Chunks
from splatree.io.formats.sog import writer as sog
from splatree.io.formats.streamed_sog.format import MANIFEST
from splatree.io.memory import Scratch
from splatree.io.options import WriteOptions
from splatree.progress import task
from splatree.scene.gaussians import Gaussians
from splatree.scene.names import Mode
from splatree.scene.scene import Scene
from splatree.shapes import Array
from splatree.stream.boxes import box_around, outward
from splatree.stream.chunks import TreeChunks, chunks_of_tree, leaves_of_chunk
from splatree.stream.errors import errors_of_levels
from splatree.stream.levels import Level, levels_of_tree
from splatree.stream.nodes import gaussians_of_level
from splatree.stream.options import StreamOptions
from splatree.stream.parts import Folder, digest_of, write_files
from splatree.stream.result import LevelWritten, Streamed
from splatree.stream.workers import affordable, in_order

__all__ = ["write_sog"]

_CHUNKS_PER_UNIT = 4
"""Chunks of the finest level in a unit: larger ones load a quarter more bytes that are not shown."""

_FINEST = 2
"""Levels whose units have ``unit_rows`` rows; those of coarser levels, which are loaded from afar, have twice as many."""

_NODE_PX = 12.0
"""Extent at which PlayCanvas draws the nodes of the first coarser level (nodes.py)."""

_ROWS_PER_ENTRY = 8
"""Rows for each entry of the palette of harmonics of a unit: its entries then cost about as much as the labels of its rows."""


@dataclass(frozen=True)
class _Unit:
    """Consecutive chunks of one level."""

    level: int
    number: int
    first_chunk: int
    end_chunk: int


@dataclass(frozen=True, eq=False)
class _Written:
    """A unit that is there."""

    name: str
    was_there: bool
    boxes: Array  # of each of its chunks "c 2 3"


def write_sog(
    scene: Scene,
    output: Path,
    options: StreamOptions,
    scratch: Scratch,
    *,
    force: bool = False,
    threads: int = 0,
) -> Streamed:
    """Write a scene with levels as a folder of streamed SOG.

    Raises:
        InputError: the options cannot be met.
        OutputError: the folder holds something else, or the disk fails.
    """
    chunk_leaves = options.chunk_leaves or leaves_of_chunk(scene.tree.num_leaves)
    options = replace(options, chunk_leaves=chunk_leaves)
    kept = scratch.part(0.5)
    chunks = chunks_of_tree(scene, chunk_leaves, kept)
    levels = levels_of_tree(scene.tree, chunks, ratio=options.ratio, num_levels=options.levels, scratch=kept)
    unit_rows = options.unit_rows or _CHUNKS_PER_UNIT * chunk_leaves
    units = list(_units(levels, unit_rows))
    threads = affordable(threads, 2 * unit_rows * scene.gaussians.row_bytes, scratch.part(0.5))
    with Folder(output, MANIFEST, force=force) as folder:
        boxes = np.empty((len(chunks), 2, 3))
        boxes[:, 0], boxes[:, 1] = np.inf, -np.inf
        names, num_there = [], 0
        with task(f"write {output.name}", sum(map(len, levels))) as advance:
            write = partial(_write_unit, scene, levels, folder, options)
            for unit, written in zip(units, in_order(write, units, threads), strict=True):
                own = slice(unit.first_chunk, unit.end_chunk)
                boxes[own, 0] = np.minimum(boxes[own, 0], written.boxes[:, 0])
                boxes[own, 1] = np.maximum(boxes[own, 1], written.boxes[:, 1])
                names.append(written.name)
                num_there += written.was_there
                offsets = levels[unit.level].offsets
                advance(int(offsets[unit.end_chunk] - offsets[unit.first_chunk]))
        errors = list(_errors(scene, options, levels, boxes, threads)) if options.errors else None
        manifest = _manifest(scene, options, levels, names, _leaves(levels, units, errors), boxes)
        folder.finish(json.dumps(manifest, separators=(",", ":")), names)
    return _result(output, folder, chunks, levels, units, names, num_there)


def _units(levels: tuple[Level, ...], unit_rows: int) -> Iterator[_Unit]:
    """Whole chunks while their rows fit, level by level; chunks of more rows alone."""
    for index, level in enumerate(levels):
        room = unit_rows if index < _FINEST else 2 * unit_rows
        first = number = 0
        num_chunks = len(level.offsets) - 1
        while first < num_chunks:
            end = int(np.searchsorted(level.offsets, level.offsets[first] + room, side="right")) - 1
            end = min(max(end, first + 1), num_chunks)
            yield _Unit(index, number, first, end)
            first, number = end, number + 1


def _write_unit(
    scene: Scene, levels: tuple[Level, ...], folder: Folder, options: StreamOptions, unit: _Unit
) -> _Written:
    level = levels[unit.level]
    offsets = level.offsets[unit.first_chunk : unit.end_chunk + 1]
    rows = level.rows[offsets[0] : offsets[-1]]
    g = gaussians_of_level(scene, level, rows, _node_px(options))
    settings = WriteOptions(sh_palette=_palette_size(len(g)) if g.sh_degree else None)
    made_from = f"{unit.level}_{unit.number}-{digest_of(g, scene.mode, settings)}"
    name = folder.find(made_from)
    was_there = name is not None
    if name is None:
        pictures, meta = sog.encode(_in_chunks(g, scene.mode), settings, order="kept")
        name = folder.make(made_from, partial(write_files, {**pictures, "meta.json": sog.as_json(meta)}))
    starts = offsets[:-1] - offsets[0]
    return _Written(name, was_there, box_around(g, starts, sigmas=1.0))


def _node_px(options: StreamOptions) -> float:
    return _NODE_PX if options.node_px is None else options.node_px


def _in_chunks(g: Gaussians, mode: Mode) -> Chunks:
    def make() -> Iterator[Gaussians]:
        return (g.rows(begin, begin + ROWS_PER_CHUNK) for begin in range(0, len(g), ROWS_PER_CHUNK))

    return Chunks(len(g), g.sh_degree, mode, make)


def _palette_size(num_rows: int) -> int:
    return min(num_rows, max(1024, 1 << int(math.log2(max(1, num_rows / _ROWS_PER_ENTRY)))))


def _errors(
    scene: Scene, options: StreamOptions, levels: tuple[Level, ...], boxes: Array, threads: int
) -> Iterator[list[float]]:
    """The errors of each chunk's levels, with seven digits."""

    def of_chunk(chunk: int) -> list[float]:
        parts = [gaussians_of_level(scene, level, level.of_chunk(chunk), _node_px(options)) for level in levels]
        return [float(f"{error:.7g}") for error in errors_of_levels(parts, boxes[chunk], scene.mode)]

    with task("compare levels", len(boxes)) as advance:
        for errors in in_order(of_chunk, range(len(boxes)), threads):
            yield errors
            advance(1)


def _manifest(
    scene: Scene,
    options: StreamOptions,
    levels: tuple[Level, ...],
    names: list[str],
    leaves: list[dict[str, Any]],
    boxes: Array,
) -> dict[str, Any]:
    record = scene.tree.record
    tree = None if record is None else json.loads(record.to_json())
    ours = {"tree": tree, "ratio": options.ratio, "sizes": [level.size for level in levels]}
    return {
        "version": 1,
        "asset": {"generator": "splatree", "chunkGaussians": options.chunk_leaves, "splatree": ours},
        "count": sum(map(len, levels)),
        "counts": [len(level) for level in levels],
        "lodLevels": len(levels),
        "lodErrors": options.errors,
        "filenames": [f"{name}/meta.json" for name in names],
        "tree": _node(leaves, boxes, 0, len(leaves)),
    }


def _leaves(levels: tuple[Level, ...], units: list[_Unit], errors: list[list[float]] | None) -> list[dict[str, Any]]:
    """What the manifest says of each chunk."""
    num_chunks = len(levels[0].offsets) - 1
    lods: list[dict[str, Any]] = [{} for _ in range(num_chunks)]
    for file, unit in enumerate(units):
        offsets = levels[unit.level].offsets
        for chunk in range(unit.first_chunk, unit.end_chunk):
            offset, count = offsets[chunk] - offsets[unit.first_chunk], offsets[chunk + 1] - offsets[chunk]
            lods[chunk][str(unit.level)] = {"file": file, "offset": int(offset), "count": int(count)}
    return [{"lods": own} if errors is None else {"lods": own, "errors": errors[i]} for i, own in enumerate(lods)]


def _node(leaves: list[dict[str, Any]], boxes: Array, first: int, end: int) -> dict[str, Any]:
    """Chunks as a binary tree: neighbours in the list are neighbours in space, so it is halved."""
    low, high = outward(boxes[first:end, 0].min(axis=0), boxes[first:end, 1].max(axis=0))
    node: dict[str, Any] = {"bound": {"min": low, "max": high}}
    if end - first == 1:
        return node | leaves[first]
    middle = (first + end) // 2
    return node | {"children": [_node(leaves, boxes, first, middle), _node(leaves, boxes, middle, end)]}


def _result(
    output: Path,
    folder: Folder,
    chunks: TreeChunks,
    levels: tuple[Level, ...],
    units: list[_Unit],
    names: list[str],
    num_there: int,
) -> Streamed:
    sizes = [folder.part_bytes(name) for name in names]
    written = tuple(
        LevelWritten(
            index,
            len(level),
            level.size,
            sum(unit.level == index for unit in units),
            sum(size for size, unit in zip(sizes, units, strict=True) if unit.level == index),
        )
        for index, level in enumerate(levels)
    )
    total = sum(sizes) + (output / MANIFEST).stat().st_size
    return Streamed(output, "sog", len(chunks), written, len(units), num_there, len(folder.damaged), total)
