"""``.splat`` (antimatter15): 32 bytes a Gaussian, no header, no harmonics beyond the DC.

======  ====  ==========================================================
offset  type  value
======  ====  ==========================================================
0       3 f4  mean
12      3 f4  standard deviations, linear
24      4 u1  RGB = ½ + C0 dc and opacity, 255 for 1
28      4 u1  unit quaternion wxyz, 128 + 128 q
======  ====  ==========================================================

Rows go by descending opacity × volume, so that a viewer that loads them one after the other shows the scene early. It is a
counting sort over quarters of an octave: one pass counts, a second puts each row in its place in the file, so a file larger than
memory is sorted in a few chunks of it. Nothing in the file says what it is: it is known by its suffix and a size that is a
multiple of 32. docs/formats/splat.md.
"""

import json
import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from splatree.errors import FormatError
from splatree.io.check import checked, checked_rows
from splatree.io.chunks import ROWS_PER_CHUNK, Chunks, repaired_chunks
from splatree.io.options import ReadOptions, WriteOptions
from splatree.kernels.cpu import splat
from splatree.progress import task
from splatree.scene.gaussians import Gaussians
from splatree.scene.scene import Scene, Source
from splatree.shapes import Array, Int64

_RECORD_BYTES = 32
_NUM_RANKS = 4096

_ROWS_PER_SORT = 1 << 17
"""4 MB of records."""


def sniff(path: Path, head: bytes) -> bool:
    """Never: the content has no mark, so only the suffix decides."""
    return False


def read(path: Path, options: ReadOptions) -> Scene:
    """Read all rows in the order of the file."""
    num_rows, metadata = _open(path, options)
    gaussians = _empty(num_rows)
    with task(f"read {path.name}", num_rows) as advance:
        for begin, part in _parts(path, num_rows, gaussians):
            advance(len(part))
            del begin
    return checked(Scene.flat(gaussians, source=Source(metadata=metadata)), str(path), repair=options.repair)


def read_chunks(path: Path, options: ReadOptions) -> Chunks:
    """Open a file to be read in chunks, in buffers that are used again."""
    num_rows, metadata = _open(path, options)

    def parts() -> Iterator[tuple[Gaussians, dict[str, int]]]:
        buffers = _empty(min(ROWS_PER_CHUNK, num_rows))
        for begin, part in _parts(path, num_rows, buffers):
            yield checked_rows(part, str(path), repair=options.repair, first_row=begin)

    whole = Chunks(num_rows, 0, "classic", lambda: (part for part, _ in parts()), metadata)
    return repaired_chunks(whole, parts) if options.repair else whole


def write_chunks(chunks: Chunks, path: Path, options: WriteOptions) -> tuple[str, ...]:
    """Write all rows by descending opacity × volume, equal ones in their order."""
    counts = np.zeros(_NUM_RANKS, np.int64)
    with path.open("wb") as file, task(f"write {path.name}", 2 * len(chunks)) as advance:
        begin = 0
        for g in chunks:  # what cannot be used has no code either
            checked_rows(g.with_sh_degree(0), "scene to write", repair=False, first_row=begin)
            counts += np.bincount(splat.ranks(g), minlength=_NUM_RANKS)
            begin += len(g)
            advance(len(g))
        sorter = _Sorter(file.fileno(), counts)
        for g in chunks:
            sorter.put(g)
            advance(len(g))
        sorter.flush()
    return ()


class _Sorter:
    """Puts records in their places in a file, some at a time: larger runs of one rank are fewer calls of the system."""

    def __init__(self, file: int, counts: Int64[Array, "r"]) -> None:
        self._file = file
        self._places = np.cumsum(counts) - counts  # of the next row of each rank
        self._records = np.empty((_ROWS_PER_SORT, _RECORD_BYTES), np.uint8)
        self._ranks = np.empty(_ROWS_PER_SORT, np.uint16)
        self._count = 0

    def put(self, g: Gaussians) -> None:
        for begin in range(0, len(g), _ROWS_PER_SORT):
            part = g.rows(begin, begin + _ROWS_PER_SORT)
            if self._count + len(part) > _ROWS_PER_SORT:
                self.flush()
            rows = slice(self._count, self._count + len(part))
            splat.encode(part, self._records[rows])
            self._ranks[rows] = splat.ranks(part)
            self._count += len(part)

    def flush(self) -> None:
        ranks = self._ranks[: self._count]
        in_order = np.take(self._records, np.argsort(ranks, kind="stable"), axis=0)
        sizes = np.bincount(ranks, minlength=_NUM_RANKS)
        found = np.flatnonzero(sizes)
        for rank, end in zip(found, np.cumsum(sizes[found]), strict=True):
            _write_at(self._file, in_order[end - sizes[rank] : end].data, _RECORD_BYTES * int(self._places[rank]))
        self._places += sizes
        self._count = 0


def _write_at(file: int, data: memoryview, offset: int) -> None:
    """All bytes: the system may take a part of them."""
    data = data.cast("B")
    while len(data):
        written = os.pwrite(file, data, offset)
        data, offset = data[written:], offset + written


def _open(path: Path, options: ReadOptions) -> tuple[int, dict[str, str]]:
    """Rows, and metadata that tells of a repair."""
    num_bytes = path.stat().st_size
    num_rows, rest = divmod(num_bytes, _RECORD_BYTES)
    if rest and not options.repair:
        raise FormatError(
            f"{path}: found {num_bytes} bytes, wanted a multiple of {_RECORD_BYTES}; the file is cut off or no .splat: read "
            f"its {num_rows} whole rows with repair"
        )
    return num_rows, {"repairs": json.dumps({"unexpected_bytes": rest})} if rest else {}


def _empty(num_rows: int) -> Gaussians:
    shapes = ((num_rows, 3), (num_rows, 4), (num_rows, 3), (num_rows,), (num_rows, 1, 3))
    return Gaussians(*(np.empty(shape, np.float32) for shape in shapes))


def _parts(path: Path, num_rows: int, out: Gaussians) -> Iterator[tuple[int, Gaussians]]:
    """Each chunk with its first row, decoded into its place in ``out``, or into the start of it if it holds no more."""
    records = np.empty((min(ROWS_PER_CHUNK, num_rows), _RECORD_BYTES), np.uint8)
    with path.open("rb", buffering=0) as file:
        for begin in range(0, num_rows, ROWS_PER_CHUNK):
            count = min(ROWS_PER_CHUNK, num_rows - begin)
            if file.readinto(records[:count].data) != count * _RECORD_BYTES:
                raise FormatError(f"{path}: cannot be read to its end; did it change meanwhile?")
            place = slice(begin, begin + count) if len(out) == num_rows else slice(0, count)
            part = out.rows(place.start, place.stop)
            splat.decode(records[:count], part)
            yield begin, part
