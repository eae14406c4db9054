"""The container of a ``.splatree``: a safetensors file, opened without reading its columns.

The file is an eight-byte length, a JSON header, and the columns, each where the header says. Everything that the header says is
held against the size of the file before a column is looked at.
"""

import json
import math
import mmap
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from splatree.errors import FormatError
from splatree.io import untrusted
from splatree.io.objects import MOST_BYTES, ObjectPath, at_once
from splatree.io.sources import Info
from splatree.shapes import Array, UInt8

__all__ = [
    "COMPACT_VERSION",
    "SPARE_BYTES",
    "VERSION",
    "Column",
    "Container",
    "append_bytes",
    "container_in",
    "header_bytes",
    "open_container",
    "placed",
]

VERSION = 1
"""Version of exact files; a new field of a scene does not change it, a new meaning does."""

COMPACT_VERSION = 2
"""Version of compact files (compact.py)."""

_HEADER_MAX = 100_000_000
"""Bytes; the limit of the safetensors library."""

_ALIGNMENT = 64
"""The first column starts at a multiple of this, so that mapped columns are aligned as kernels like them."""

SPARE_BYTES = 160
"""Room in a header for one column more (`append_bytes`)."""

NEAR_BYTES = 1 << 16
"""A gap that is fetched along with what lies around it: a request takes longer."""

_DTYPES = {
    "BOOL": "bool",
    "U8": "uint8",
    "I8": "int8",
    "U16": "uint16",
    "I16": "int16",
    "U32": "uint32",
    "I32": "int32",
    "F32": "float32",
    "U64": "uint64",
    "I64": "int64",
    "F64": "float64",
}
_NAMES = {dtype: name for name, dtype in _DTYPES.items()}


@dataclass(frozen=True)
class Column:
    """Where a column lies in the file."""

    dtype: np.dtype[Any]
    """Its type, little-endian."""
    shape: tuple[int, ...]
    """Its shape, rows first."""
    start: int
    """Its first byte in the file."""

    @property
    def num_bytes(self) -> int:
        """Bytes of the whole column."""
        return math.prod(self.shape) * self.dtype.itemsize

    @property
    def bytes_per_row(self) -> int:
        """Bytes of one row."""
        return math.prod(self.shape[1:]) * self.dtype.itemsize

    def rows(self, begin: int, end: int | None) -> "Column":
        """Where some of its rows lie; None: to its end."""
        begin, end, _ = slice(begin, end).indices(self.shape[0] if self.shape else 1)
        shape = (max(end - begin, 0), *self.shape[1:])
        return Column(self.dtype, shape, self.start + begin * self.bytes_per_row)


@dataclass(frozen=True, eq=False)
class Container:
    """An open file: what its header says, and the columns on demand."""

    path: Path
    """The file."""
    values: Mapping[str, Any]
    """The strings of the header."""
    columns: Mapping[str, Column]
    """The columns by name."""
    bytes: "Mapped | Held | Ranged"
    """The bytes of the file."""

    @property
    def is_compact(self) -> bool:
        """Whether the columns are quantised (compact.py)."""
        return bool(self.values["version"] == str(COMPACT_VERSION))

    @property
    def is_elsewhere(self) -> bool:
        """Whether it is an object of a store, each row of which is fetched when it is asked for."""
        return isinstance(self.bytes, Ranged)

    def rows(self, name: str, begin: int = 0, end: int | None = None) -> Array:
        """Rows of a column, as a view of the mapped file; a copy where they are not aligned."""
        return self.rows_of([name], begin, end)[0]

    def rows_of(self, names: Sequence[str], begin: int = 0, end: int | None = None) -> list[Array]:
        """Rows of several columns, as `rows`; of an object of a store, they are asked for at the same time."""
        return [
            rows if rows.flags.aligned else rows.copy()
            for rows in self.bytes.arrays([self.columns[name].rows(begin, end) for name in names])
        ]

    def forget(self, name: str, begin: int, end: int) -> None:
        """Let the system take back the memory of rows of a column; they are read again when they are used again."""
        column = self.columns[name]
        self.bytes.forget(column.start + begin * column.bytes_per_row, column.start + end * column.bytes_per_row)


@dataclass(frozen=True, eq=False)
class Mapped:
    """The bytes of a file of this machine, mapped read-only: a page is read when a value on it is."""

    memory: mmap.mmap

    def arrays(self, wanted: Sequence[Column]) -> list[Array]:
        """Columns as views: nothing is read yet."""
        return _views(self.memory, wanted)

    def forget(self, start: int, end: int) -> None:
        """Let the system take back the memory of the bytes."""
        first, last = -(-start // mmap.PAGESIZE) * mmap.PAGESIZE, end // mmap.PAGESIZE * mmap.PAGESIZE
        if last > first and hasattr(mmap, "MADV_DONTNEED"):  # Windows takes back what it needs
            self.memory.madvise(mmap.MADV_DONTNEED, first, last - first)


@dataclass(frozen=True, eq=False)
class Held:
    """Bytes that are in memory."""

    memory: memoryview

    def arrays(self, wanted: Sequence[Column]) -> list[Array]:
        """Columns as views."""
        return _views(self.memory, wanted)

    def forget(self, start: int, end: int) -> None:
        """Nothing is given back."""


def _views(memory: mmap.mmap | memoryview, wanted: Sequence[Column]) -> list[Array]:
    return [
        np.ndarray(each.shape, each.dtype, memory, each.start) if each.num_bytes else np.empty(each.shape, each.dtype)
        for each in wanted
    ]


@dataclass(frozen=True, eq=False)
class Ranged:
    """The bytes of an object of a store, each range read when it is asked for."""

    path: ObjectPath
    info: Info | None
    """What the store said of it when it was opened."""

    def arrays(self, wanted: Sequence[Column]) -> list[Array]:
        """Columns, read now: near ones by one request, others by requests at the same time."""
        runs = list(_near(wanted))
        blocks = at_once(lambda run: self.path.read_range(*run, self.info), runs)
        found = []
        for each in wanted:
            block, (begin, _) = next(
                (block, run)
                for block, run in zip(blocks, runs, strict=True)
                if run[0] <= each.start and each.start + each.num_bytes <= run[1]
            )
            values = np.frombuffer(block, each.dtype, math.prod(each.shape), each.start - begin)
            found.append(values.reshape(each.shape))
        return found

    def forget(self, start: int, end: int) -> None:
        """Nothing is kept."""


def _near(columns: Sequence[Column]) -> Iterator[tuple[int, int]]:
    """Runs of bytes that hold the columns, of which those with small gaps between them are in one."""
    begin = end = -1
    for column in sorted(columns, key=lambda column: column.start):
        stop = column.start + column.num_bytes
        if end >= 0 and column.start <= end + NEAR_BYTES and stop <= begin + MOST_BYTES:
            end = max(end, stop)
            continue
        if end >= 0:
            yield begin, end
        begin, end = column.start, stop
    if end >= 0:
        yield begin, end


def open_container(path: Path) -> Container:
    """Read and check the header of a file, and map the file; of an object nothing else is read yet.

    Raises:
        FormatError: the file is cut off, damaged, or of another kind or version.
    """
    where = str(path)
    info = path.info() if isinstance(path, ObjectPath) else None
    with path.open("rb") as file:
        num_bytes = path.stat().st_size
        text = _header_of(file, num_bytes, where)
        if isinstance(path, ObjectPath):
            held: Mapped | Ranged = Ranged(path, info)
        else:
            held = Mapped(mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ))
    return _container(path, text, num_bytes, held)


def container_in(column: UInt8[Array, "b"], path: Path) -> Container:
    """A container whose bytes are a column of a file.

    Raises:
        FormatError: it is damaged, or of another kind or version.
    """
    where = str(path)
    return _container(path, _header_of(BytesIO(column.data), len(column), where), len(column), Held(column.data))


def append_bytes(path: Path, name: str, data: bytes) -> None:
    """Add a column of bytes behind all others of a file; its header was written with `SPARE_BYTES`."""
    with path.open("r+b") as file:
        size = int.from_bytes(file.read(8), "little")
        header = json.loads(file.read(size))
        start = file.seek(0, 2) - 8 - size
        file.write(data)
        header[name] = {"dtype": "U8", "shape": [len(data)], "data_offsets": [start, start + len(data)]}
        text = json.dumps(header, separators=(",", ":")).encode()
        assert len(text) <= size
        file.seek(8)
        file.write(text.ljust(size))


def _header_of(file: BinaryIO, num_bytes: int, where: str) -> bytes:
    header_size = int.from_bytes(file.read(8), "little")
    if not 2 <= header_size <= min(_HEADER_MAX, num_bytes - 8):
        raise FormatError(
            f"{where}: found a header of {header_size} bytes in a file of {num_bytes}; the file is cut off or no .splatree"
        )
    return file.read(header_size)


def _container(path: Path, text: bytes, num_bytes: int, held: Mapped | Held | Ranged) -> Container:
    where = str(path)
    header = untrusted.as_object(untrusted.parse_json(text, where), where)
    values = untrusted.as_object(header.pop("__metadata__", None), f"{where}: __metadata__")
    version = values.get("version")
    if values.get("format") != "splatree" or version not in (str(VERSION), str(COMPACT_VERSION)):
        raise FormatError(
            f"{where}: found format {values.get('format')!r}, version {version!r}, wanted 'splatree', '{VERSION}' or "
            f"'{COMPACT_VERSION}'; a newer file needs a newer splatree, other safetensors are no scene"
        )
    start = 8 + len(text)
    columns = {name: _column(entry, start, num_bytes, f"{where}: {name}") for name, entry in header.items()}
    total = sum(column.num_bytes for column in columns.values())
    if total != num_bytes - start:
        raise FormatError(
            f"{where}: found {num_bytes - start} bytes behind the header, wanted {total} for its columns; the file is cut off "
            "or damaged"
        )
    return Container(path, values, columns, held)


def placed(shapes: Mapping[str, tuple[np.dtype[Any], tuple[int, ...]]]) -> dict[str, Column]:
    """Where columns of these types and shapes go, counted from the end of the header.

    Wide types come first. Then each column is aligned, as its predecessors' sizes are multiples of its own width.
    """
    columns: dict[str, Column] = {}
    start = 0
    for name, (dtype, shape) in sorted(shapes.items(), key=lambda item: -item[1][0].itemsize):
        columns[name] = Column(dtype, shape, start)
        start += columns[name].num_bytes
    return columns


def header_bytes(values: Mapping[str, str], columns: Mapping[str, Column], *, spare: int = 0) -> bytes:
    """The head of a file: the length of the header and the header, padded, with so many bytes to spare."""
    header: dict[str, Any] = {"__metadata__": {"format": "splatree", "version": str(VERSION), **values}}
    for name, column in columns.items():
        ends = [column.start, column.start + column.num_bytes]
        header[name] = {"dtype": _NAMES[column.dtype.name], "shape": column.shape, "data_offsets": ends}
    text = json.dumps(header, separators=(",", ":")).encode()
    text += b" " * spare
    text += b" " * (-(8 + len(text)) % _ALIGNMENT)
    return len(text).to_bytes(8, "little") + text


def _column(entry: Any, start: int, num_bytes: int, where: str) -> Column:
    entry = untrusted.as_object(entry, where)
    name = untrusted.text(entry, "dtype", where)
    if name not in _DTYPES:
        raise FormatError(f"{where}: found dtype {name!r}, wanted one of {', '.join(_DTYPES)}")
    dtype = np.dtype(_DTYPES[name]).newbyteorder("<")
    sizes = untrusted.as_list(untrusted.field(entry, "shape", where), where)
    shape = tuple(untrusted.as_integer(size, f"{where}: shape") for size in sizes)
    ends = untrusted.as_list(untrusted.field(entry, "data_offsets", where), where)
    offsets = [untrusted.as_integer(end, f"{where}: data_offsets", high=2**62) for end in ends]
    size = math.prod(shape) * dtype.itemsize
    if math.prod(max(s, 1) for s in shape) > 2**48:  # NumPy cannot hold it even where an axis is 0
        raise FormatError(f"{where}: found shape {shape}, which no file holds; the header is damaged")
    if len(shape) > 8 or len(offsets) != 2 or offsets[1] - offsets[0] != size or start + offsets[1] > num_bytes:
        raise FormatError(
            f"{where}: found bytes {offsets} for shape {shape} of {dtype.name} ({size} bytes) in a file that holds "
            f"{num_bytes - start} bytes of columns; the file is cut off or damaged"
        )
    return Column(dtype, shape, start + offsets[0])
