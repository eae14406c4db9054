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
counting sort over quarters of an octave: records are counted by rank as they are made, then each is put in its place; of a
scene larger than memory they wait in a temporary file. Nothing in the file says what it is: it is known by its suffix and a size
that is a multiple of 32. docs/reference/formats/splat.md.
"""

import json
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import BinaryIO, Self

import numpy as np

from splatree.constants import SH_C0
from splatree.errors import FormatError
from splatree.io.check import are_within, magnitudes_of, refuse_unusable
from splatree.io.chunks import ROWS_PER_CHUNK, Chunks
from splatree.io.colors import num_clipped
from splatree.io.notes import gaussians_in_words
from splatree.io.options import ReadOptions, WriteOptions
from splatree.io.rows import FileRows, Fill
from splatree.kernels.cpu.codec import splat
from splatree.kernels.cpu.runtime.files import reserve
from splatree.progress import task
from splatree.scene.gaussians import Gaussians
from splatree.scene.scene import Scene
from splatree.shapes import Array

_RECORD_BYTES = 32
_NUM_RANKS = 4096

_ROWS_IN_MEMORY = 1 << 20
"""36 MB of records and ranks; those of a larger scene wait in a temporary file beside the target."""

_ROWS_PLACED = 1 << 17
"""4 MB of records are put in order at a time: the larger, the longer the runs of one rank, each a call of the system."""


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
    counts, clipped = np.zeros(_NUM_RANKS, np.int64), 0
    with path.open("wb") as file, _Rows(path.parent, len(chunks)) as rows:
        reserve(file, len(chunks) * _RECORD_BYTES)
        with task(f"write {path.name}", 2 * len(chunks)) as advance:
            first_row = 0
            for chunk in chunks:
                for begin in range(0, len(chunk), _ROWS_IN_MEMORY):
                    g = chunk.rows(begin, begin + _ROWS_IN_MEMORY)
                    records, ranks = rows.more(len(g))
                    largest = splat.encode(g, records)
                    if not are_within(g, magnitudes_of(g, sh=largest)):  # what cannot be used has no code either
                        refuse_unusable(g.with_sh_degree(0), "scene to write", first_row=first_row)
                    clipped += num_clipped(g.sh[:, 0]) if largest > 0.5 / SH_C0 else 0
                    splat.ranks(g, ranks)
                    counts += np.bincount(ranks, minlength=_NUM_RANKS)
                    first_row += len(g)
                    advance(len(g))
            places = np.cumsum(counts) - counts  # of the next row of each rank
            for records, ranks in rows.all():
                splat.place(records, ranks, places, file)
                advance(len(ranks))
    return (f"the colours of {gaussians_in_words(clipped)}: splat clips them to 0 to 1",) if clipped else ()


class _Rows:
    """Records and their ranks, in the order in which they came; all but the last ones wait in a file if they are many."""

    def __init__(self, folder: Path, num_rows: int) -> None:
        self._folder, self._stack = folder, ExitStack()
        self._is_large = num_rows > _ROWS_IN_MEMORY
        self._records = np.empty((min(num_rows, _ROWS_IN_MEMORY), _RECORD_BYTES), np.uint8)
        self._ranks = np.empty(len(self._records), np.uint16)
        self._held = 0
        self._file: BinaryIO | None = None
        self._num_in_file: list[int] = []

    def __enter__(self) -> Self:
        if self._is_large:
            import tempfile

            self._file = self._stack.enter_context(tempfile.TemporaryFile(dir=self._folder))
        return self

    def __exit__(self, *exception: object) -> None:
        self._stack.close()

    def more(self, count: int) -> tuple[Array, Array]:
        """Room for the next rows, valid until it is asked for again."""
        if self._held + count > len(self._records):
            self._put_aside()
        rows = slice(self._held, self._held + count)
        self._held += count
        return self._records[rows], self._ranks[rows]

    def all(self) -> Iterator[tuple[Array, Array]]:
        """All rows, some at a time."""
        if self._file is not None:
            self._put_aside()
            self._file.seek(0)
        for count in self._num_in_file or [self._held]:
            if self._file is not None:
                self._file.readinto(self._records[:count].data)  # type: ignore[attr-defined]
                self._file.readinto(self._ranks[:count].data)  # type: ignore[attr-defined]
            for begin in range(0, count, _ROWS_PLACED):
                rows = slice(begin, min(begin + _ROWS_PLACED, count))
                yield self._records[rows], self._ranks[rows]

    def _put_aside(self) -> None:
        assert self._file is not None  # the others hold all rows
        self._file.write(self._records[: self._held].data)
        self._file.write(self._ranks[: self._held].data)
        self._num_in_file.append(self._held)
        self._held = 0


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
    if num_bytes == 0:
        metadata["notes"] = json.dumps(
            [f"{path.name} is empty, which is how a .splat of no Gaussians looks, or a download cut off"]
        )
    return FileRows(str(path), num_rows, 0, start, metadata=metadata)
