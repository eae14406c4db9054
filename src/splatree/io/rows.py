"""Files whose rows are decoded some at a time: into a whole scene, or into chunks that are used again.

A reader of such a format checks what frames the rows (`FileRows`) and says how some of them are decoded; the rest is here.
Whole or in chunks, the values are the same.
"""

import json
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from splatree.io.check import add_counts, checked, checked_rows
from splatree.io.chunks import ROWS_PER_CHUNK, Chunks, Counts, counted_chunks
from splatree.io.options import ReadOptions
from splatree.progress import task, track
from splatree.scene.gaussians import Gaussians
from splatree.scene.names import Mode
from splatree.scene.scene import Scene, Source
from splatree.shapes import Array

__all__ = ["FileRows", "Fill", "columns_to_fill", "records_of", "regrouped", "scene_of"]

Fill = Callable[[int, Gaussians], None]
"""Decodes the rows from a number on into columns, as many as these hold."""


@dataclass(frozen=True, eq=False)
class FileRows:
    """The Gaussians of one flat file."""

    where: str
    """The file, as errors name it."""
    num_rows: int
    """Gaussians in all."""
    sh_degree: int
    """Degree of the harmonics."""
    open: Callable[[], AbstractContextManager[Fill]]
    """Start a pass over the rows. Within it `ROWS_PER_CHUNK` of them are asked for at a time, in order and to the last one."""
    mode: Mode = "classic"
    """How the scene is drawn."""
    metadata: dict[str, str] | None = None
    """As that of `Source`."""

    def scene(self, options: ReadOptions) -> Scene:
        """All rows, their values checked."""
        return checked(self.unchecked_scene(), self.where, repair=options.repair)

    def unchecked_scene(self) -> Scene:
        """All rows, whatever their values."""
        gaussians = columns_to_fill(self.num_rows, self.sh_degree)
        with self.open() as fill, task(f"read {Path(self.where).name}", self.num_rows) as advance:
            for begin in range(0, self.num_rows, ROWS_PER_CHUNK):
                part = gaussians.rows(begin, begin + ROWS_PER_CHUNK)
                fill(begin, part)
                advance(len(part))
        return Scene.flat(gaussians, mode=self.mode, source=Source(metadata=self.metadata or {}))

    def parts(self) -> Iterator[tuple[Gaussians, Counts]]:
        """All rows, whatever their values, in buffers that are used again, and that nothing was changed in them."""
        buffers = columns_to_fill(min(ROWS_PER_CHUNK, self.num_rows), self.sh_degree)
        with self.open() as fill:
            for begin in range(0, self.num_rows, ROWS_PER_CHUNK):
                part = buffers.rows(0, self.num_rows - begin)
                fill(begin, part)
                yield part, {}

    def chunks(self, options: ReadOptions) -> Chunks:
        """The rows in chunks, in buffers that are used again."""

        def parts() -> Iterator[tuple[Gaussians, Counts]]:
            begin = 0
            for part, _ in self.parts():
                yield checked_rows(part, self.where, repair=options.repair, first_row=begin)
                begin += len(part)

        drops_rows = bool(options.repair)
        return counted_chunks(
            parts, self.num_rows, self.sh_degree, self.mode, self.metadata or {}, drops_rows=drops_rows
        )


def scene_of(chunks: Chunks, what: str) -> Scene:
    """A scene that is read in chunks, in memory; ``what`` names the work for who watches it."""
    gaussians, begin = columns_to_fill(len(chunks), chunks.sh_degree), 0
    for chunk in track(chunks, what):
        for name, column in vars(chunk).items():
            getattr(gaussians, name)[begin : begin + len(chunk)] = column
        begin += len(chunk)
    metadata = dict(chunks.metadata)
    if counts := add_counts(metadata.get("repairs"), chunks.repairs):
        metadata["repairs"] = json.dumps(counts)
    return Scene.flat(gaussians, mode=chunks.mode, source=Source(metadata=metadata, origin=chunks.origin))


def regrouped(chunks: Iterable[Gaussians], num_rows: int, sh_degree: int) -> Iterator[Gaussians]:
    """The rows of chunks, so many at a time and what is left at last, in buffers that are used again."""
    buffers = columns_to_fill(num_rows, sh_degree)
    num_filled = 0
    for chunk in chunks:
        while len(chunk):
            count = min(len(chunk), num_rows - num_filled)
            for name, column in vars(chunk).items():
                getattr(buffers, name)[num_filled : num_filled + count] = column[:count]
            num_filled, chunk = num_filled + count, chunk.rows(count, len(chunk))
            if num_filled == num_rows:
                yield buffers
                num_filled = 0
    if num_filled:
        yield buffers.rows(0, num_filled)


def columns_to_fill(num_rows: int, sh_degree: int) -> Gaussians:
    """Columns without values yet."""
    k = (sh_degree + 1) ** 2
    shapes = ((num_rows, 3), (num_rows, 4), (num_rows, 3), (num_rows,), (num_rows, k, 3))
    return Gaussians(*(np.empty(shape, np.float32) for shape in shapes))


def records_of(file: BinaryIO, record: "np.dtype[Any]", count: int) -> Array:
    """The next records of a file of this machine or of a store; fewer than ``count`` where it ends."""
    records = np.empty(count, record)
    num_bytes: int = file.readinto(records.view(np.uint8).data) if count else 0  # type: ignore[attr-defined]
    return records[: num_bytes // records.itemsize]
