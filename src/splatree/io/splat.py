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
counting sort over quarters of an octave: records go to a temporary file and are counted by rank, then each is put in its place;
so a scene larger than memory takes a few MB of it. Nothing in the file says what it is: it is known by its suffix and a size
that is a multiple of 32. docs/formats/splat.md.
"""

import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from splatree.errors import FormatError
from splatree.io.check import refuse_unusable
from splatree.io.chunks import ROWS_PER_CHUNK, Chunks
from splatree.io.options import ReadOptions, WriteOptions
from splatree.io.rows import FileRows, Fill
from splatree.kernels.cpu import splat
from splatree.progress import task
from splatree.scene.gaussians import Gaussians
from splatree.scene.scene import Scene

_RECORD_BYTES = 32
_NUM_RANKS = 4096

_ROWS_AT_ONCE = 1 << 17
"""4 MB of records are put in order at a time: the larger, the longer the runs of one rank, each a call of the system."""

_SPOOL_BYTES = 1 << 23
"""What is written to a temporary file beside the target if it is more than this."""


def sniff(path: Path, head: bytes) -> bool:
    """Never: the content has no mark, so only the suffix decides."""
    return False


def read(path: Path, options: ReadOptions) -> Scene:
    """Read all rows in the order of the file."""
    return _open(path, options).scene(options)


def read_chunks(path: Path, options: ReadOptions) -> Chunks:
    """Open a file to be read in chunks: the same values."""
    return _open(path, options).chunks(options)


def write_chunks(chunks: Chunks, path: Path, options: WriteOptions) -> tuple[str, ...]:
    """Write all rows by descending opacity × volume, equal ones in their order."""
    from tempfile import SpooledTemporaryFile

    counts = np.zeros(_NUM_RANKS, np.int64)
    records, ranks = np.empty((_ROWS_AT_ONCE, _RECORD_BYTES), np.uint8), np.empty(_ROWS_AT_ONCE, np.uint16)
    with (
        SpooledTemporaryFile(_SPOOL_BYTES, dir=str(path.parent)) as all_records,
        SpooledTemporaryFile(_SPOOL_BYTES, dir=str(path.parent)) as all_ranks,
        path.open("wb") as file,
        task(f"write {path.name}", 2 * len(chunks)) as advance,
    ):
        first_row = 0
        for chunk in chunks:
            for begin in range(0, len(chunk), _ROWS_AT_ONCE):
                g = chunk.rows(begin, begin + _ROWS_AT_ONCE)
                # What cannot be used has no code either.
                refuse_unusable(g.with_sh_degree(0), "scene to write", first_row=first_row)
                splat.encode(g, records[: len(g)])
                splat.ranks(g, ranks[: len(g)])
                counts += np.bincount(ranks[: len(g)], minlength=_NUM_RANKS)
                all_records.write(records[: len(g)].data)
                all_ranks.write(ranks[: len(g)].data)
                first_row += len(g)
                advance(len(g))
        places = np.cumsum(counts) - counts  # of the next row of each rank
        all_records.seek(0)
        all_ranks.seek(0)
        while num_bytes := all_ranks.readinto(ranks.data):
            count = num_bytes // ranks.itemsize
            all_records.readinto(records[:count].data)
            in_order = np.take(records, np.argsort(ranks[:count], kind="stable"), axis=0)
            sizes = np.bincount(ranks[:count], minlength=_NUM_RANKS)
            found = np.flatnonzero(sizes)
            for rank, end in zip(found, np.cumsum(sizes[found]), strict=True):
                _write_at(file.fileno(), in_order[end - sizes[rank] : end].data, _RECORD_BYTES * int(places[rank]))
            places += sizes
            advance(count)
    return ()


def _write_at(file: int, data: memoryview, offset: int) -> None:
    """All bytes: the system may take a part of them."""
    data = data.cast("B")
    while len(data):
        written = os.pwrite(file, data, offset)
        data, offset = data[written:], offset + written


def _open(path: Path, options: ReadOptions) -> FileRows:
    num_bytes = path.stat().st_size
    num_rows, rest = divmod(num_bytes, _RECORD_BYTES)
    if rest and not options.repair:
        raise FormatError(
            f"{path}: found {num_bytes} bytes, wanted a multiple of {_RECORD_BYTES}; the file is cut off or no .splat: read "
            f"its {num_rows} whole rows with repair"
        )

    @contextmanager
    def start() -> Iterator[Fill]:
        records = np.empty((min(ROWS_PER_CHUNK, num_rows), _RECORD_BYTES), np.uint8)
        with path.open("rb", buffering=0) as file:

            def fill(begin: int, out: Gaussians) -> None:
                if file.readinto(records[: len(out)].data) != len(out) * _RECORD_BYTES:
                    raise FormatError(f"{path}: cannot be read to its end; did it change meanwhile?")
                splat.decode(records[: len(out)], out)

            yield fill

    metadata = {"repairs": json.dumps({"unexpected_bytes": rest})} if rest else {}
    return FileRows(str(path), num_rows, 0, start, metadata=metadata)
