"""``.compressed.ply`` (PlayCanvas): chunks of 256 Gaussians, each value in a few bits of its chunk's range.

========  ==============================================================================================
element   a row of it
========  ==============================================================================================
chunk     18 f4: least and largest x y z, log-scales, r g b (older files: 12, colours within 0 to 1)
vertex    4 u4: position and scale in 11 10 11 bits, rotation in 2 10 10 10, colour and opacity in 8 8 8 8
sh        3K u1: harmonics, channel by channel, 256 (½ + sh / 8); missing at degree 0
========  ==============================================================================================

A value's step is its chunk's range over 2047 or 1023, so chunks must be small in space: the writer puts the rows along a Z-curve
first (on a town, 3 mm of error in a position instead of 93 mm). All codes are made and read by the native core
(`splatree.kernels`, stage packed). Layout and deviations: docs/reference/formats/compressed_ply.md.
"""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np

from splatree.errors import FormatError
from splatree.io.check import LOGIT_FROM_BYTE, refuse_unusable
from splatree.io.chunks import Chunks
from splatree.io.formats.ply.header import HEADER_MAX, Element, Text, parse_text
from splatree.io.formats.ply.skip import refuse_converted_lines
from splatree.io.memory import Scratch
from splatree.io.notes import gaussians_in_words
from splatree.io.options import ReadOptions, WriteOptions
from splatree.io.rows import FileRows, Fill, records_of
from splatree.io.sorting import along_curve
from splatree.kernels.cpu.codec.packed import CHUNK, pack, unpack
from splatree.kernels.cpu.runtime.files import write_at
from splatree.progress import task
from splatree.scene.gaussians import Gaussians
from splatree.scene.scene import Scene
from splatree.shapes import Array

_BOUNDS = [
    f"{end}_{kind}{axis}"
    for kind, axes in (("", "xyz"), ("scale_", "xyz"), ("", "rgb"))
    for end in ("min", "max")
    for axis in axes
]
_VERTEX = ["packed_position", "packed_rotation", "packed_scale", "packed_color"]
_DEGREES = {0: 0, 9: 1, 24: 2, 45: 3}

_PLACES = np.array([2047, 1023, 2047])
"""Steps of a position along x, y and z."""

LOG_SCALE_MAX = 20
"""Log-scales beyond ± this have no code …"""

SH_MAX = 4
"""… nor have harmonics beyond ± this."""


def sniff(path: Path, head: bytes) -> bool:
    """Whether the file is a .ply with a packed position."""
    return head[:4] in (b"ply\n", b"ply\r") and b" packed_position" in head and b"element chunk " in head


def read(path: Path, options: ReadOptions) -> Scene:
    """Read all rows in the order of the file."""
    return _rows(path, options).scene(options)


def read_chunks(path: Path, options: ReadOptions) -> Chunks:
    """Open a file to be read in chunks: the same values."""
    return _rows(path, options).chunks(options)


def _rows(path: Path, options: ReadOptions) -> FileRows:
    packed = _open(path, options)

    @contextmanager
    def start() -> Iterator[Fill]:
        buffers: dict[str, Array] = {}
        with path.open("rb", buffering=0) as file:
            yield lambda begin, out: packed.fill(file, begin, out, buffers)

    return FileRows(str(path), packed.num_rows, packed.degree, start, packed.text.mode, packed.metadata)


def write_chunks(chunks: Chunks, path: Path, options: WriteOptions) -> tuple[str, ...]:
    """Write all rows along a Z-curve; count those with values beyond the codes, and those moved by more than their size."""
    n, num_rest = len(chunks), 3 * ((chunks.sh_degree + 1) ** 2 - 1)
    lines = ["ply", "format binary_little_endian 1.0"]
    if chunks.mode == "antialiased":
        lines.append("comment SplatRenderMode: mip")
    lines += [f"element chunk {-(-n // CHUNK)}", *(f"property float {name}" for name in _BOUNDS)]
    lines += [f"element vertex {n}", *(f"property uint {name}" for name in _VERTEX)]
    if num_rest:
        lines += [f"element sh {n}", *(f"property uchar f_rest_{i}" for i in range(num_rest))]
    head = "\n".join([*lines, "end_header", ""]).encode()
    vertices_at = len(head) + 4 * len(_BOUNDS) * -(-n // CHUNK)
    rest_at, begin, num_moved = vertices_at + 4 * len(_VERTEX) * n, 0, 0
    clamped = {f"log-scales beyond ±{LOG_SCALE_MAX}": 0, f"harmonics beyond ±{SH_MAX}": 0}

    def look(g: Gaussians, first_row: int) -> None:
        refuse_unusable(g, "scene to write", first_row=first_row)
        beyond = (np.abs(g.log_scales) > LOG_SCALE_MAX, np.abs(g.sh[:, 1:]) > SH_MAX)
        for what, wrong in zip(clamped, beyond, strict=True):
            clamped[what] += int(wrong.reshape(len(g), -1).any(axis=1).sum()) if wrong.size else 0

    with (
        along_curve(chunks, Scratch.beside(path, options.max_memory), look) as ordered,
        path.open("wb", buffering=0) as file,
        task(f"write {path.name}", n) as advance,
    ):
        write_at(file, 0, head)
        for g in ordered:
            bounds, vertices, rest = pack(g, np.arange(len(g)))
            num_moved += _num_moved(g, bounds)
            write_at(file, len(head) + begin // CHUNK * bounds.itemsize * len(_BOUNDS), bounds)
            write_at(file, vertices_at + begin * vertices.itemsize * len(_VERTEX), vertices)
            write_at(file, rest_at + begin * num_rest, rest)
            begin += len(g)
            advance(len(g))
    lost = [f"{what}: clamped in {gaussians_in_words(count)}" for what, count in clamped.items() if count]
    if num_moved:
        lost.append(
            f"the places of {gaussians_in_words(num_moved)}: rounded by up to more than their size, as they share a chunk with "
            "far ones; `splatree clean` drops outliers"
        )
    return tuple(lost)


def _num_moved(g: Gaussians, bounds: Array) -> int:
    """How many rows may be moved by more than their largest standard deviation: half a step of their chunk."""
    step = ((bounds[:, 3:6].astype(np.float64) - bounds[:, :3]) / _PLACES).max(axis=1)  # [c]
    return int((np.exp(g.log_scales.max(axis=1)) < np.repeat(step / 2, CHUNK)[: len(g)]).sum())


@dataclass(frozen=True)
class _Packed:
    """A file whose header was read and held against its size, and its bounds."""

    path: Path
    text: Text
    num_rows: int
    degree: int
    bounds: Array  # [c 18]
    starts: dict[str, int]  # byte of each element
    types: dict[str, np.dtype[np.void]]  # a row of each element
    metadata: dict[str, str]

    def fill(self, file: BinaryIO, begin: int, out: Gaussians, buffers: dict[str, Array]) -> None:
        """Decode the rows from ``begin`` on, a multiple of 256, into the columns of ``out``; keep ``buffers`` for the next."""
        n = len(out)
        vertices = _matrix(self._records(file, "vertex", begin, n, buffers), _VERTEX, np.uint32)
        names = [f"f_rest_{i}" for i in range(3 * ((self.degree + 1) ** 2 - 1))]
        rest = np.empty((n, 0), np.uint8)
        if names:
            rest = _matrix(self._records(file, "sh", begin, n, buffers), names, np.uint8)
        first = begin // CHUNK
        bounds = self.bounds[first : first + -(-n // CHUNK)]
        unpack(
            bounds, vertices, rest, LOGIT_FROM_BYTE, (out.means, out.quats, out.log_scales, out.logit_opacities, out.sh)
        )

    def _records(self, file: BinaryIO, element: str, begin: int, count: int, buffers: dict[str, Array]) -> Array:
        """Rows of an element, valid until the next ones are read."""
        row = self.types[element]
        if element not in buffers or len(buffers[element]) < count:
            buffers[element] = np.empty(count, row)
        records = buffers[element][:count]
        file.seek(self.starts[element] + begin * row.itemsize)
        if file.readinto(records.view(np.uint8).data) != count * row.itemsize:  # type: ignore[attr-defined]
            raise FormatError(f"{self.path}: cannot be read to its end; did it change meanwhile?")
        return records


def _matrix(records: Array, names: list[str], dtype: type) -> Array:
    """Fields of records side by side."""
    if records.dtype == np.dtype([(name, dtype) for name in names]):
        return records.view(dtype).reshape(len(records), len(names))
    return np.stack([records[name].astype(dtype) for name in names], axis=1)


def _open(path: Path, options: ReadOptions) -> _Packed:
    """Read the header and the bounds."""
    num_bytes = path.stat().st_size
    with path.open("rb") as file:
        text = parse_text(path, file.read(HEADER_MAX))
        if text.encoding == "ascii":
            raise FormatError(f"{path}: found a compressed .ply as text, wanted binary; write it again")
        elements, starts, at = {element.name: element for element in text.elements}, {}, text.num_bytes
        for element in text.elements:
            starts[element.name] = at
            at += element.num_bytes
        degree = _check_elements(path, text, elements)
        if num_bytes > at:
            refuse_converted_lines(file, text.num_bytes, path)
        metadata = _check_size(path, num_bytes, at, options)
        types = {name: np.dtype(element.properties) for name, element in elements.items()}
        bounds = np.zeros((elements["chunk"].count, len(_BOUNDS)), np.float32)
        bounds[:, 15:] = 1  # colours of older files lie within 0 to 1
        file.seek(starts["chunk"])
        records = records_of(file, types["chunk"], len(bounds))
        has_colors = _BOUNDS[12] in (types["chunk"].names or ())
        names = _BOUNDS if has_colors else _BOUNDS[:12]
        bounds[:, : len(names)] = _matrix(records, names, np.float32)
    if text.comments:
        metadata["comments"] = json.dumps(text.comments)
    lost = ["surfels: read as Gaussians with the third scale of the file"] if text.are_surfels else []
    if extra := [name for name, _ in elements["vertex"].properties if name not in _VERTEX]:
        lost.append(f"the properties {', '.join(extra)}: splatree does not know them, and draws without them")
    if others := [f"{e.name} ({e.count:,} rows)" for e in text.elements if e.name not in (*_WANTED, "sh") and e.count]:
        lost.append(f"the elements {', '.join(others)}: splatree does not know them, and draws without them")
    if lost:
        metadata["lost"] = json.dumps(lost)
    return _Packed(path, text, elements["vertex"].count, degree, bounds, starts, types, metadata)


_WANTED = {"chunk": (_BOUNDS[:12], ("f4", "f8")), "vertex": (_VERTEX, ("u4",))}
"""Properties that each element must have, and the types that these may be of."""


def _check_elements(path: Path, text: Text, elements: dict[str, Element]) -> int:
    """The degree of the harmonics."""
    if any(element.has_lists for element in text.elements):
        raise FormatError(f"{path}: found lists, wanted scalars only; this is no compressed .ply")
    for name, (wanted, kinds) in _WANTED.items():
        found = {n: kind[1:] for n, kind in elements[name].properties} if name in elements else {}
        if name == "chunk" and not found.keys().isdisjoint(_BOUNDS[12:]):
            wanted = _BOUNDS  # newer files have ranges of colours, all six
        for field in wanted:
            if found.get(field) not in kinds:
                raise FormatError(
                    f"{path}: element {name!r}: found {field} {'of type ' + found[field] if field in found else 'missing'}, "
                    f"wanted it of type {' or '.join(kinds)}; this is no compressed .ply"
                )
    n = elements["vertex"].count
    if elements["chunk"].count != -(-n // CHUNK):
        raise FormatError(
            f"{path}: found {elements['chunk'].count} chunks for {n} Gaussians, wanted {-(-n // CHUNK)} of {CHUNK} each"
        )
    rest = dict(elements["sh"].properties) if "sh" in elements else {}
    num_rest = sum(name.startswith("f_rest_") for name in rest)
    if num_rest not in _DEGREES or any(rest.get(f"f_rest_{i}", "")[1:] != "u1" for i in range(num_rest)):
        raise FormatError(
            f"{path}: element 'sh': found {num_rest} properties f_rest_*, wanted 0, 9, 24 or 45, uchar and numbered from 0"
        )
    if num_rest and elements["sh"].count != n:
        raise FormatError(f"{path}: element 'sh': found {elements['sh'].count} rows, wanted {n}, as many as vertices")
    return _DEGREES[num_rest]


def _check_size(path: Path, num_bytes: int, wanted: int, options: ReadOptions) -> dict[str, str]:
    if num_bytes < wanted:
        raise FormatError(
            f"{path}: found {num_bytes} bytes, wanted {wanted} for the rows that its header announces; it is cut off"
        )
    if num_bytes > wanted and not options.repair:
        raise FormatError(
            f"{path}: found {num_bytes} bytes, {num_bytes - wanted} more than its header announces; read it with repair to "
            "ignore them"
        )
    return {"repairs": json.dumps({"unexpected_bytes": num_bytes - wanted})} if num_bytes > wanted else {}
