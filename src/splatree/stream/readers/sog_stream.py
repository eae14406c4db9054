"""A written streamed SOG as a viewer sees it: chunks with boxes, and for each level the range of a file that holds its rows.

Reads what any tool wrote, so that streams of different tools can be compared (`splatree.stream.readers.playcanvas`).
"""

import json
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from splatree.io.formats.sog import reader as sog
from splatree.io.formats.streamed_sog.format import MANIFEST
from splatree.io.formats.streamed_sog.format import files as files_of_stream
from splatree.io.options import ReadOptions
from splatree.scene.gaussians import Gaussians
from splatree.scene.names import Mode
from splatree.scene.scene import Scene
from splatree.shapes import Array, Float64, Int64, check_fields

__all__ = ["Ranges", "SogStream", "open_sog_stream"]


@dataclass(frozen=True, eq=False)
class Ranges:
    """Where the rows of each level and chunk are."""

    boxes: Float64[Array, "c 2 3"]
    """Lower and upper corner of each chunk's box."""
    files: Int64[Array, "l c"]
    """Number of the file; −1 where the chunk does not have the level."""
    offsets: Int64[Array, "l c"]
    """First row in the file."""
    counts: Int64[Array, "l c"]
    """Rows; 0 where the chunk does not have the level."""
    errors: Float64[Array, "l c"] | None
    """How far each level is from the finest; None: the stream does not say."""

    def __post_init__(self) -> None:
        check_fields(self)


class SogStream:
    """An open stream; files are decoded when they are first needed, and kept."""

    def __init__(self, folder: Path, meta: dict[str, Any]) -> None:
        self.folder = folder
        """The folder."""
        self.ranges: Ranges = _ranges(meta)
        """What the manifest says."""
        self._names: list[str] = list(meta["filenames"])
        self._decoded: dict[int, Scene] = {}

    @cached_property
    def file_bytes(self) -> Int64[Array, "f"]:
        """Size of each file: of a unit, all of its pictures and its meta.json."""
        units = ([path for path in sog.files(self.folder / name) if path.exists()] for name in self._names)
        return np.array([sum(path.stat().st_size for path in unit) for unit in units], np.int64)

    @property
    def mode(self) -> Mode:
        """How the scene is drawn."""
        return self._unit(0).mode

    def files_of(self, levels: Array) -> Int64[Array, "f"]:
        """Files that hold the chunks, each at its level "c"."""
        chosen = self.ranges.files[levels, np.arange(len(levels))]
        return np.unique(chosen[chosen >= 0])

    def gaussians_of(self, levels: Array) -> Gaussians:
        """The rows of all chunks, each at its level "c", as decoded."""
        parts = [self.rows_of(chunk, level) for chunk, level in enumerate(levels) if self.ranges.counts[level, chunk]]
        return Gaussians.concatenate(parts)

    def rows_of(self, chunk: int, level: int) -> Gaussians:
        """The rows of one level of a chunk, which has it."""
        r = self.ranges
        offset, count = r.offsets[level, chunk], r.counts[level, chunk]
        return self._unit(int(r.files[level, chunk])).gaussians.rows(offset, offset + count)

    def _unit(self, file: int) -> Scene:
        if file not in self._decoded:
            self._decoded[file] = sog.open_rows(self.folder / self._names[file], ReadOptions()).unchecked_scene()
        return self._decoded[file]


def open_sog_stream(folder: Path) -> SogStream:
    """Open the stream whose ``lod-meta.json`` is in the folder.

    Raises:
        FormatError: the manifest is not one.
    """
    files_of_stream(folder)  # checks what frames the units
    return SogStream(folder, json.loads((folder / MANIFEST).read_text("utf-8")))


def _ranges(meta: dict[str, Any]) -> Ranges:
    leaves: list[dict[str, Any]] = []
    pending = [meta["tree"]]
    while pending:
        node = pending.pop()
        if "lods" in node:
            leaves.append(node)
        pending += reversed(node.get("children") or [])
    num_levels = int(meta["lodLevels"])
    table = np.zeros((3, num_levels, len(leaves)), np.int64)
    table[0] = -1
    for chunk, leaf in enumerate(leaves):
        for level, entry in leaf["lods"].items():
            table[:, int(level), chunk] = entry["file"], entry["offset"], entry["count"]
    boxes = np.array([[leaf["bound"]["min"], leaf["bound"]["max"]] for leaf in leaves], np.float64)
    tables = [leaf.get("errors") for leaf in leaves]
    errors = None if None in tables else np.array(tables, np.float64).T.copy()
    return Ranges(boxes, table[0], table[1], table[2], errors)
