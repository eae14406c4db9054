"""Records and Gaussians in the order of a key, of scenes larger than memory.

A sample of the keys divides them into parts of about equal size. Each record goes to the end of the file of its part; parts are
read one after the other, and sorted in memory. Records of equal keys keep their order, so the order does not depend on how many
parts there are. Where all records fit in memory, they are one part, without a file.

Cost: records are written and read once; memory is one part, a quarter of what is allowed.
"""

import tempfile
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import fields, replace
from typing import IO, Self

import numpy as np

from splatree.io.chunks import ROWS_PER_CHUNK, Chunks
from splatree.io.memory import Scratch
from splatree.maths.morton import frame_of_sample, morton_codes, morton_sample
from splatree.scene.gaussians import Gaussians
from splatree.shapes import Array, UInt8, UInt64

__all__ = ["Sorter", "along_curve", "sampled_means"]

_KEY_BYTES = 8
_ORDER_BYTES = 16
"""What sorting takes for a record beside the record and its key."""

_PARTS_MAX = 256
"""Files that are open at the same time."""


class Sorter:
    """Takes records with keys, and gives them back in the order of the keys, as often as that is asked for."""

    def __init__(self, num_rows: int, record_bytes: int, sample: UInt64[Array, "s"], scratch: Scratch) -> None:
        """For so many records of so many bytes; ``sample`` are some of the keys."""
        self._width, self._scratch = _KEY_BYTES + record_bytes, scratch
        needed = num_rows * (self._width + _ORDER_BYTES)
        num_parts = 1 if needed <= scratch.room else int(min(_PARTS_MAX, 4 * needed // max(scratch.room, 1) + 2))
        if num_parts == 1:
            scratch.room -= needed
        cuts = np.sort(sample)[np.linspace(0, len(sample), num_parts, endpoint=False).astype(np.intp)[1:]]
        same, counts = np.unique(cuts, return_counts=True)
        often = same[
            (counts > 1) & (same < np.iinfo(np.uint64).max)
        ]  # a part of its own, which is in order as it comes
        self._cuts: Array = np.unique(np.concatenate([same, often + np.uint64(1)]))
        self._counts = np.zeros(len(self._cuts) + 1, np.int64)
        self._ends = np.tile(np.array([np.iinfo(np.uint64).max, 0], np.uint64), (len(self._counts), 1))
        self._rows = np.empty((num_rows if num_parts == 1 else 0, self._width), np.uint8)
        self._num_held = 0
        self._files: list[IO[bytes]] = []
        self._stack = ExitStack()

    def __enter__(self) -> Self:
        if not len(self._rows):
            for _ in self._counts:
                self._files.append(self._stack.enter_context(tempfile.TemporaryFile(dir=self._scratch.folder)))
        return self

    def __exit__(self, *exception: object) -> None:
        self._stack.close()

    def put(self, keys: UInt64[Array, "n"], records: UInt8[Array, "n b"]) -> None:
        """Take the next records."""
        rows = np.concatenate([keys.view(np.uint8).reshape(-1, _KEY_BYTES), records], axis=1)
        if not self._files:
            self._rows[self._num_held : self._num_held + len(rows)] = rows
            self._num_held += len(rows)
            return
        parts = np.searchsorted(self._cuts, keys, side="right")
        order = np.argsort(parts, kind="stable")
        found, first = np.unique(parts[order], return_index=True)
        for part, own in zip(found.tolist(), np.split(order, first[1:]), strict=True):
            self._files[part].write(rows[own].data)
            self._counts[part] += len(own)
            low, high = self._ends[part]
            self._ends[part] = min(low, keys[own].min()), max(high, keys[own].max())

    def runs(self, rows_at_once: int = ROWS_PER_CHUNK) -> Iterator[tuple[Array, Array]]:
        """All keys and records in order, some at a time; a run has ``rows_at_once`` of them, and the last one what is left."""
        left = np.empty((0, self._width), np.uint8)
        for piece in self._sorted_pieces(rows_at_once):
            left = np.concatenate([left, piece])
            while len(left) >= rows_at_once:
                yield _parted(left[:rows_at_once])
                left = left[rows_at_once:]
        if len(left):
            yield _parted(left)

    def _sorted_pieces(self, rows_at_once: int) -> Iterator[Array]:
        if not self._files:
            yield from _in_order(self._rows, rows_at_once)
        for file, count, (low, high) in zip(self._files, self._counts.tolist(), self._ends, strict=False):
            file.seek(0)
            if low < high:
                yield from _in_order(self._read(file, count), rows_at_once)
                continue
            for begin in range(0, count, rows_at_once):
                yield self._read(file, min(rows_at_once, count - begin))

    def _read(self, file: IO[bytes], count: int) -> Array:
        rows = np.empty((count, self._width), np.uint8)
        file.readinto(rows.data)  # type: ignore[attr-defined]
        return rows


def _in_order(rows: Array, rows_at_once: int) -> Iterator[Array]:
    order = np.argsort(_parted(rows)[0], kind="stable")
    for begin in range(0, len(rows), rows_at_once):
        yield rows[order[begin : begin + rows_at_once]]


def _parted(rows: Array) -> tuple[Array, Array]:
    """The keys, and the records as a view."""
    return np.ascontiguousarray(rows[:, :_KEY_BYTES]).view(np.uint64).reshape(-1), rows[:, _KEY_BYTES:]


def sampled_means(chunks: Chunks, look: Callable[[Gaussians, int], None] | None = None) -> Array:
    """The means that a `MortonFrame` is found from, by a pass over all rows; ``look`` is shown each chunk and its first row."""
    every, begin, sample = morton_sample(len(chunks)).step, 0, [np.empty((0, 3), np.float32)]
    for g in chunks:
        if look is not None:
            look(g, begin)
        sample.append(g.means[-begin % every :: every].copy())
        begin += len(g)
    return np.concatenate(sample)


@contextmanager
def along_curve(
    chunks: Chunks, scratch: Scratch, look: Callable[[Gaussians, int], None] | None = None
) -> Iterator[Chunks]:
    """The same Gaussians along a Z-curve, for as long as the context lasts; ``look`` is shown each chunk as it comes."""
    sample = sampled_means(chunks, look)
    frame = frame_of_sample(sample)
    width = sum(int(np.prod(column.shape[1:])) for column in vars(Gaussians.empty(chunks.sh_degree)).values())
    with Sorter(len(chunks), 4 * width, morton_codes(sample, frame), scratch) as sorter:
        for g in chunks:
            columns = [getattr(g, field.name).reshape(len(g), -1) for field in fields(Gaussians)]
            sorter.put(morton_codes(g.means, frame), np.concatenate(columns, axis=1).view(np.uint8))
        yield replace(
            chunks, make=lambda: (_gaussians(rows, chunks.sh_degree) for _, rows in sorter.runs()), repairs={}
        )


def _gaussians(rows: Array, sh_degree: int) -> Gaussians:
    values, begin, columns = np.ascontiguousarray(rows).view(np.float32), 0, []
    for column in vars(Gaussians.empty(sh_degree)).values():
        width = int(np.prod(column.shape[1:]))
        part = np.ascontiguousarray(values[:, begin : begin + width])
        columns.append(part.reshape(len(values), *column.shape[1:]))
        begin += width
    return Gaussians(*columns)
