"""The vertices of a .ply as columns: opened, held against the file's size, and filled some rows at a time.

One native pass reads a binary little-endian file chunk by chunk and takes it apart in the cache: no copy of the file is ever in
memory, and the cost is about that of reading it once. Big-endian files and text, which are rare, go through NumPy, and so do the
coordinates of files in double precision that lie far from zero: they are taken relative to an origin before they are rounded.
"""

import json
import os
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import BinaryIO

import numpy as np

from splatree.constants import SH_C0
from splatree.errors import FormatError
from splatree.io.check import Magnitudes, magnitudes_of
from splatree.io.formats.ply.filter3d import fuse_filter
from splatree.io.formats.ply.header import HEADER_MAX, Header, parse_header
from splatree.io.formats.ply.properties import DC, RGB, Fields, fields_of
from splatree.io.formats.ply.skip import bytes_of, refuse_converted_lines
from splatree.io.formats.ply.text import lines_of, records_of
from splatree.io.objects import ObjectPath
from splatree.io.options import ReadOptions
from splatree.kernels.cpu.codec.columns import deinterleave
from splatree.scene.gaussians import Gaussians
from splatree.scene.origin import NO_ORIGIN, Origin, origin_of
from splatree.shapes import Array

__all__ = ["COLUMNS", "Vertices", "gaussians_of", "open_vertices"]

COLUMNS = ("means", "quats", "log_scales", "logit_opacities", "sh")

_SURFEL_LOG_SCALE = float(np.log(1e-6))
"""Thickness that surfels (2DGS) are given: thinner than any pixel, thick enough for float32."""

_ROWS_OF_TEXT = 1 << 12
_ROWS_OF_SAMPLE = 1 << 16
"""Rows that the origin is found from, spread evenly over the file."""

_OVERSHOOT = 16
"""Colours from 0 to 1 may overshoot as f_dc does; a scene of 0 to 255 that stays below this is black."""

FUSED = (
    "the 3D filter (filter_3D of Mip-Splatting or GOF) was fused into scales and opacities, as their save_fused_ply does; scenes "
    "of Mip-Splatting are meant to be drawn with --mode antialiased"
)


@dataclass(frozen=True)
class Vertices:
    """A file whose header was read and held against its size."""

    path: Path
    """The file."""
    header: Header
    """Its header."""
    start: int
    """Byte of the first vertex of a binary file."""
    num_rows: int
    """Rows to read."""
    fields: Fields
    """Which properties go where."""
    color_max: float
    """What stands for a colour of 1, where colours are red, green and blue."""
    origin: Origin
    """What is taken off the means."""
    metadata: dict[str, str]
    """As that of `Source`."""

    def buffers(self, rows: int) -> list[Array]:
        """Columns for so many rows, to be filled."""
        return [np.empty((rows, len(names)), np.float32) for names in self.fields.columns]

    def lines(self, file: BinaryIO) -> Iterator[bytes]:
        """The lines of a text from the first vertex on; none of a binary file."""
        if self.header.encoding != "ascii":
            return iter(())
        return islice(lines_of(self.path, file, self.start), self.header.lines_before, None)

    def fill(self, file: BinaryIO, lines: Iterator[bytes], begin: int, columns: list[Array]) -> Magnitudes:
        """Read the rows from ``begin`` on into the columns: of a text, the next ones of its ``lines``."""
        try:
            if self.header.encoding == "binary_little_endian" and not isinstance(self.path, ObjectPath):
                start = self.start + begin * self.header.dtype.itemsize
                largest = deinterleave(file, start, self.header.dtype, self.fields.columns, columns)
                magnitudes = dict(zip(COLUMNS, largest, strict=False))
                if self.origin != NO_ORIGIN:
                    self._fill_means(_records(file, self.header, start, len(columns[0])), columns[0])
                    magnitudes = {}
            else:
                self._fill_slowly(file, lines, begin, columns)
                magnitudes = {}
        except EOFError as error:
            raise FormatError(f"{self.path}: cannot be read to its end ({error}); did it change meanwhile?") from error
        names = self.header.names
        if self.fields.has_filter:
            axes = slice(0, 3 if "scale_2" in names else 2)
            scales, logits = fuse_filter(columns[2][:, axes], columns[3][:, 0], columns[5][:, 0])
            columns[2][:, axes], columns[3][:, 0] = scales, logits
            magnitudes = {}
        if "scale_2" not in names:
            columns[2][:, 2] = _SURFEL_LOG_SCALE
            magnitudes = {}
        if DC[0] not in names:  # the inverse of colour = ½ + C0 dc
            dc = columns[4][:, :3]
            np.divide(dc / np.float32(self.color_max) - np.float32(0.5), np.float32(SH_C0), out=dc)
            magnitudes = {}
        return magnitudes or magnitudes_of(gaussians_of(columns))

    def _fill_means(self, records: Array, means: Array) -> None:
        with np.errstate(over="ignore"):
            for axis, name in enumerate(self.fields.columns[0]):
                means[:, axis] = records[name].astype(np.float64) - self.origin[axis]

    def _fill_slowly(self, file: BinaryIO, lines: Iterator[bytes], begin: int, columns: list[Array]) -> None:
        num_rows, header = len(columns[0]), self.header
        if header.encoding != "ascii":
            file.seek(self.start + begin * header.dtype.itemsize)
        for first in range(0, num_rows, _ROWS_OF_TEXT):
            count = min(_ROWS_OF_TEXT, num_rows - first)
            if header.encoding == "ascii":
                records = records_of(self.path, list(islice(lines, count)), header.dtype, begin + first)
            else:
                records = np.frombuffer(file.read(count * header.dtype.itemsize), header.dtype)
            if len(records) < count:
                raise EOFError("the file ends before its last record")
            with np.errstate(over="ignore"):  # doubles beyond float32 are infinite, as the check of values says
                for column, names in zip(columns, self.fields.columns, strict=True):
                    for j, name in enumerate(names):
                        column[first : first + count, j] = records[name]
            if self.origin != NO_ORIGIN:
                self._fill_means(records, columns[0][first : first + count])


def gaussians_of(columns: list[Array]) -> Gaussians:
    """The Gaussians in columns that were filled."""
    means, quats, log_scales, logits, harmonics = columns[:5]
    return Gaussians(
        means, quats, log_scales, logits.reshape(-1), harmonics.reshape(len(means), harmonics.shape[1] // 3, 3)
    )


def open_vertices(path: Path, options: ReadOptions) -> Vertices:
    """Read the header, hold it against the file's size, and say where the values go.

    Raises:
        FormatError: the header is damaged, the file too short or too long, or its vertices are no Gaussians.
    """
    with path.open("rb") as file:
        header = parse_header(path, file.read(HEADER_MAX))
        is_text = header.encoding == "ascii"
        start = header.start + (0 if is_text else bytes_of(file, header.start, header.before, path))
        num_rows, repairs = _check_size(file, path, header, start, repair=bool(options.repair))
        fields = fields_of(path, header, ignore=options.ignore_properties)
        bare = Vertices(path, header, start, num_rows, fields, 1.0, NO_ORIGIN, {})
        color_max = 1.0 if DC[0] in header.names else _color_max(file, bare)
        origin = _origin(file, bare)
    metadata = {
        "extra_properties": fields.extra,
        "comments": header.comments,
        "lost": fields.lost,
        "notes": [FUSED] if fields.has_filter else [],
        "repairs": repairs,
    }
    kept = {k: json.dumps(v) for k, v in metadata.items() if v}
    return replace(bare, color_max=color_max, origin=origin, metadata=kept)


def _origin(file: BinaryIO, vertices: Vertices) -> Origin:
    """An origin for coordinates with more digits than float32 has: doubles, and numbers in text."""
    header, columns = vertices.header, vertices.fields.columns
    kinds = {header.dtype[name] for name in columns[0]}
    if header.encoding != "ascii" and not any(kind.kind == "f" and kind.itemsize == 8 for kind in kinds):
        return NO_ORIGIN
    if header.encoding == "ascii":
        lines = list(islice(vertices.lines(file), min(_ROWS_OF_TEXT, vertices.num_rows)))
        records = records_of(vertices.path, lines, header.dtype, 0)
    else:
        step = max(1, vertices.num_rows // _ROWS_OF_SAMPLE)
        records = _every(file, vertices, step)
    points, scales = (
        np.stack([records[name].astype(np.float64) for name in names], axis=1) if len(records) else np.zeros((0, 3))
        for names in (columns[0], columns[2])
    )
    return origin_of(points, scales.astype(np.float32))


def _every(file: BinaryIO, vertices: Vertices, step: int) -> Array:
    """Every ``step``-th record; of an object all are gone through, since each request takes as long as a few of them."""
    dtype, n = vertices.header.dtype, vertices.num_rows
    if not isinstance(vertices.path, ObjectPath):
        return np.memmap(file, dtype, "r", vertices.start, (n,))[::step]
    runs = range(0, n, _ROWS_OF_SAMPLE)
    parts = [
        _records(file, vertices.header, vertices.start + i * dtype.itemsize, min(_ROWS_OF_SAMPLE, n - i))[
            -i % step :: step
        ]
        for i in runs
    ]
    return np.concatenate([np.empty(0, dtype), *parts])


def _color_max(file: BinaryIO, vertices: Vertices) -> float:
    """What stands for a colour of 1: 255 of bytes; of other numbers what the largest of them says, 1, 255 or 65535."""
    header = vertices.header
    names = [header.names[name] for name in RGB]
    kinds = [header.dtype[name] for name in names]
    if all(kind == np.uint8 for kind in kinds) or not vertices.num_rows:
        return 255.0
    largest, lines = 0.0, vertices.lines(file)
    for begin in range(0, vertices.num_rows, _ROWS_OF_SAMPLE):
        count = min(_ROWS_OF_SAMPLE, vertices.num_rows - begin)
        if header.encoding == "ascii":
            records = records_of(vertices.path, list(islice(lines, count)), header.dtype, begin)
        else:
            records = _records(file, header, vertices.start + begin * header.dtype.itemsize, count)
        largest = max(largest, *(float(np.nanmax(records[name].astype(np.float64), initial=0)) for name in names))
        for name, kind in zip(names, kinds, strict=True):
            if kind.kind == "i" and (records[name] < 0).any():
                raise FormatError(
                    f"{vertices.path}: found {name} of {int(records[name].min())} as a whole number with a sign, wanted 0 or "
                    "more; bytes above 127 are of type uchar, not char: write the file again"
                )
    if all(kind.kind == "f" for kind in kinds) and largest < _OVERSHOOT:
        return 1.0
    return 255.0 if largest <= 255 else 65535.0


def _records(file: BinaryIO, header: Header, start: int, count: int) -> Array:
    file.seek(start)
    data = file.read(count * header.dtype.itemsize)
    if len(data) < count * header.dtype.itemsize:
        raise EOFError("the file ends before its last record")
    return np.frombuffer(data, header.dtype)


def _check_size(file: BinaryIO, path: Path, header: Header, start: int, *, repair: bool) -> tuple[int, dict[str, int]]:
    """Rows to read, and repairs done: the vertices must fill the file to its end, but for other elements behind them."""
    if header.encoding == "ascii":
        return _check_lines(file, path, header, repair=repair)
    num_bytes, record_bytes = path.stat().st_size, header.dtype.itemsize
    wanted = start + header.count * record_bytes
    if num_bytes < wanted:
        whole = max(0, num_bytes - start) // record_bytes if record_bytes else 0
        if not repair:
            raise FormatError(
                f"{path}: found {num_bytes} bytes, wanted {wanted} for the {header.count} vertices of {record_bytes} bytes "
                f"that its header announces; the file is cut off (or its header lies): read the {whole} whole ones "
                "with repair"
            )
        return whole, {"missing_rows": header.count - whole}
    if header.bytes_after is not None and num_bytes != wanted + header.bytes_after:
        excess = num_bytes - wanted - header.bytes_after
        if excess > 0:
            refuse_converted_lines(file, start, path)
        if not repair:
            behind = f", {header.bytes_after} bytes behind them" if header.bytes_after else ""
            raise FormatError(
                f"{path}: found {num_bytes} bytes, {abs(excess)} {'more' if excess > 0 else 'fewer'} than its header announces "
                f"({header.count} vertices of {record_bytes} bytes{behind}); read it with repair to take these vertices alone"
            )
        return header.count, {"unexpected_bytes" if excess > 0 else "missing_bytes": abs(excess)}
    return header.count, {}


def _check_lines(file: BinaryIO, path: Path, header: Header, *, repair: bool) -> tuple[int, dict[str, int]]:
    """The same of a text, by its lines."""
    num_lines, last = 0, b""
    for line in lines_of(path, file, header.start):
        num_lines, last = num_lines + 1, line
    found = num_lines - header.lines_before
    if found < header.count:
        file.seek(-1, os.SEEK_END)
        is_whole = file.read(1) in b"\r\n" and len(last.split()) == len(header.dtype.names or ())
        whole = max(0, found - (not is_whole))
        if not repair:
            raise FormatError(
                f"{path}: found {max(0, found)} lines of vertices, wanted {header.count}; the file is cut off (or its header "
                f"lies): read the {whole} whole ones with repair"
            )
        return whole, {"missing_rows": header.count - whole}
    excess = found - header.count - header.lines_after
    if excess and not repair:
        raise FormatError(
            f"{path}: found {abs(excess)} line{'s' * (abs(excess) != 1)} {'more' if excess > 0 else 'less'} than its header "
            f"announces ({header.count} vertices); read it with repair to take these vertices alone"
        )
    name = "unexpected_lines" if excess > 0 else "missing_lines"
    return header.count, {name: abs(excess)} if excess else {}
