"""3DGS ``.ply``: the file that training writes (Kerbl 2023), one float32 record a Gaussian.

``x y z nx ny nz f_dc_0..2 f_rest_0..3K-1 opacity scale_0..2 rot_0..3``, binary little-endian, K = 0, 3, 8, 15 harmonics a
channel beyond the DC. ``f_rest`` is channel-major: all K of red, then of green, then of blue; scales are natural logarithms,
opacity is a logit, the quaternion is wxyz and need not have length one. Layout and deviations: docs/reference/formats/ply.md.

Reading goes by name, so properties may come in any order and as any scalar type. One native pass reads the file chunk by
chunk and takes it apart in the cache: no copy of the file is ever in memory, and the cost is about that of reading it once.
Big-endian files and text, which are rare, go through NumPy.
"""

import json
import re
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import BinaryIO

import numpy as np

from splatree.constants import SH_C0
from splatree.errors import FormatError
from splatree.io.check import Magnitudes, checked, checked_rows, magnitudes_of
from splatree.io.chunks import ROWS_PER_CHUNK, Chunks, counted_chunks
from splatree.io.formats.ply.header import HEADER_MAX, Header, parse_header
from splatree.io.options import ReadOptions, WriteOptions
from splatree.kernels.cpu.codec.columns import deinterleave, interleave
from splatree.kernels.cpu.runtime.files import reserve
from splatree.progress import task
from splatree.scene.gaussians import Gaussians
from splatree.scene.scene import Scene, Source
from splatree.shapes import Array

_GEOMETRY = (
    ("x", "y", "z"),
    ("rot_0", "rot_1", "rot_2", "rot_3"),
    ("scale_0", "scale_1", "scale_2"),
    ("opacity",),
)
"""Properties of the columns means, quats, log_scales, logit_opacities."""

_COLUMNS = ("means", "quats", "log_scales", "logit_opacities", "sh")
_DC = ("f_dc_0", "f_dc_1", "f_dc_2")
_RGB = ("red", "green", "blue")
_NORMALS = ("nx", "ny", "nz")

_NUM_REST = {0: 0, 9: 1, 24: 2, 45: 3, 72: 4}
"""Degree by the number of properties f_rest."""

_SURFEL_LOG_SCALE = float(np.log(1e-6))
"""Thickness that surfels (2DGS) are given: thinner than any pixel, thick enough for float32."""

_ROWS_OF_TEXT = 1 << 12


def sniff(path: Path, head: bytes) -> bool:
    """Whether the file is a .ply of any kind."""
    return head[:4] in (b"ply\n", b"ply\r")


def read(path: Path, options: ReadOptions) -> Scene:
    """Read a 3DGS .ply.

    Normals are dropped; other properties that are not of 3DGS are dropped and named in the metadata (`extra_properties`);
    harmonics of degree 4 are cut off, surfels read as flat Gaussians, and the metadata (`lost`) says so.
    """
    ply = _open(path, options)
    columns = [np.empty((ply.num_rows, len(names)), np.float32) for names in ply.fields]
    with path.open("rb") as file, task(f"read {path.name}", ply.num_rows) as advance:
        magnitudes = ply.fill(file, 0, columns)
        advance(ply.num_rows)
    scene = Scene.flat(_gaussians(columns), mode=ply.header.mode, source=Source(metadata=ply.metadata))
    return checked(scene, str(path), repair=options.repair, magnitudes=magnitudes)


def read_chunks(path: Path, options: ReadOptions) -> Chunks:
    """Open a 3DGS .ply to be read in chunks: the same values, in buffers that are used again."""
    ply = _open(path, options)

    def parts() -> Iterator[tuple[Gaussians, dict[str, int]]]:
        rows = min(ROWS_PER_CHUNK, ply.num_rows)
        buffers = [np.empty((rows, len(names)), np.float32) for names in ply.fields]
        with path.open("rb") as file:
            for begin in range(0, ply.num_rows, ROWS_PER_CHUNK):
                columns = [buffer[: ply.num_rows - begin] for buffer in buffers]
                magnitudes = ply.fill(file, begin, columns)
                yield checked_rows(
                    _gaussians(columns), str(path), repair=options.repair, magnitudes=magnitudes, first_row=begin
                )

    drops_rows = bool(options.repair)
    return counted_chunks(parts, ply.num_rows, ply.degree, ply.header.mode, ply.metadata, drops_rows=drops_rows)


def write_chunks(chunks: Chunks, path: Path, options: WriteOptions) -> tuple[str, ...]:
    """Write the layout of the 3DGS code, zero normals included; every value keeps its bits."""
    rest = [f"f_rest_{i}" for i in range(3 * ((chunks.sh_degree + 1) ** 2 - 1))]
    means, quats, log_scales, logits = _GEOMETRY
    names = [*means, *_NORMALS, *_DC, *rest, *logits, *log_scales, *quats]
    fields = [*_GEOMETRY, _sh_fields(_DC, chunks.sh_degree, chunks.sh_degree)]
    lines = ["ply", "format binary_little_endian 1.0"]
    if chunks.mode == "antialiased":
        lines.append("comment SplatRenderMode: mip")
    lines += [f"element vertex {len(chunks)}", *(f"property float {name}" for name in names), "end_header", ""]
    records = np.zeros(0, [(name, "<f4") for name in names])
    with path.open("wb", buffering=0) as file, task(f"write {path.name}", len(chunks)) as advance:
        header = "\n".join(lines).encode()
        reserve(file, len(header) + len(chunks) * records.itemsize)
        _write_all(file, memoryview(header))
        for g in chunks:
            if len(records) < len(g):
                records = np.zeros(len(g), records.dtype)
            columns = [getattr(g, name).reshape(len(g), len(f)) for name, f in zip(_COLUMNS, fields, strict=True)]
            interleave(columns, fields, records)
            _write_all(file, records[: len(g)].view(np.uint8).data)
            advance(len(g))
    return ()


def _write_all(file: BinaryIO, data: memoryview) -> None:
    """All bytes: an unbuffered write may take a part of them."""
    while len(data):
        data = data[file.write(data) :]


def _gaussians(columns: list[Array]) -> Gaussians:
    means, quats, log_scales, logits, harmonics = columns
    return Gaussians(
        means, quats, log_scales, logits.reshape(-1), harmonics.reshape(len(means), harmonics.shape[1] // 3, 3)
    )


@dataclass(frozen=True)
class _Ply:
    """A file whose header was read and held against its size."""

    path: Path
    header: Header
    num_rows: int
    fields: list[list[str]]
    """Properties of each column, the harmonics coefficient by coefficient with RGB inside."""
    degree: int
    metadata: dict[str, str]

    def fill(self, file: BinaryIO, begin: int, columns: list[Array]) -> Magnitudes:
        """Read the rows from ``begin`` on into the columns; text must be read in order."""
        try:
            if self.header.encoding == "binary_little_endian":
                start = self.header.start + begin * self.header.dtype.itemsize
                largest = deinterleave(file, start, self.header.dtype, self.fields, columns)
                magnitudes = dict(zip(_COLUMNS, largest, strict=True))
            else:
                self._fill_slowly(file, begin, columns)
                magnitudes = {}
        except EOFError as error:
            raise FormatError(f"{self.path}: cannot be read to its end ({error}); did it change meanwhile?") from error
        names = self.header.names
        if "scale_2" not in names:
            columns[2][:, 2] = _SURFEL_LOG_SCALE
            magnitudes = {}
        if _DC[0] not in names:  # RGB of 8 bits, or 0 to 1: the inverse of colour = ½ + C0 dc
            is_bytes = self.header.dtype[names["red"]].kind in "iu"
            dc = columns[4][:, :3]
            np.divide(dc / np.float32(255 if is_bytes else 1) - np.float32(0.5), np.float32(SH_C0), out=dc)
            magnitudes = {}
        return magnitudes or magnitudes_of(_gaussians(columns))

    def _fill_slowly(self, file: BinaryIO, begin: int, columns: list[Array]) -> None:
        num_rows, dtype = len(columns[0]), self.header.dtype
        if begin == 0:
            file.seek(self.header.start)
            for _ in islice(file, self.header.lines_before if self.header.encoding == "ascii" else 0):
                pass
        for first in range(0, num_rows, _ROWS_OF_TEXT):
            count = min(_ROWS_OF_TEXT, num_rows - first)
            if self.header.encoding == "ascii":
                records = _records_of_text(self.path, list(islice(file, count)), dtype, begin + first)
            else:
                records = np.frombuffer(file.read(count * dtype.itemsize), dtype)
            if len(records) < count:
                raise EOFError("the file ends before its last record")
            with np.errstate(over="ignore"):  # doubles beyond float32 are infinite, as the check of values says
                for column, names in zip(columns, self.fields, strict=True):
                    for j, name in enumerate(names):
                        column[first : first + count, j] = records[name]


def _records_of_text(path: Path, lines: list[bytes], dtype: np.dtype[np.void], first: int) -> Array:
    """Rows of numbers as records of doubles."""
    width = len(dtype.names or ())
    rows = [line.split() for line in lines]
    wrong = next((i for i, row in enumerate(rows) if len(row) != width), None)
    if wrong is not None:
        raise FormatError(
            f"{path}: vertex {first + wrong}: found {len(rows[wrong])} values, wanted {width}; the file is cut off or damaged"
        )
    try:
        values = np.array(rows, "S").astype(np.float64)
    except ValueError as error:
        raise FormatError(f"{path}: vertices {first} to {first + len(rows)}: {error}; wanted numbers") from error
    return values.view([(name, "<f8") for name in dtype.names or ()]).reshape(len(rows))


def _open(path: Path, options: ReadOptions) -> _Ply:
    with path.open("rb") as file:
        header = parse_header(path, file.read(HEADER_MAX))
    num_rows, repairs = _check_size(path, header, path.stat().st_size, repair=bool(options.repair))
    fields, degree, lost = _fields(path, header)
    used = {name for names in fields for name in names} | {header.names.get(n) for n in _NORMALS}
    dropped = re.compile(r"(scalar_)?f_rest_\d+")
    extra = [name for name in header.dtype.names or () if name not in used and not dropped.fullmatch(name)]
    metadata = {
        "extra_properties": extra,
        "comments": header.comments,
        "lost": lost,
        "repairs": repairs,
    }
    return _Ply(path, header, num_rows, fields, degree, {k: json.dumps(v) for k, v in metadata.items() if v})


def _check_size(path: Path, header: Header, num_bytes: int, *, repair: bool) -> tuple[int, dict[str, int]]:
    """Rows to read, and repairs done: the vertices must fill the file to its end, but for other elements behind them."""
    record_bytes = header.dtype.itemsize
    if header.encoding == "ascii":
        shortest = 2 * len(header.dtype.names or ())  # a digit and a space for each value
        wanted = header.start + header.count * shortest
        if num_bytes + 1 < wanted:  # the last line may lack its end
            raise FormatError(
                f"{path}: found {num_bytes} bytes, wanted at least {wanted} for the {header.count} vertices that its header "
                "announces; the file is cut off"
            )
        return header.count, {}
    wanted = header.start + header.count * record_bytes
    if num_bytes < wanted:
        whole = max(0, num_bytes - header.start) // record_bytes if record_bytes else 0
        if not repair:
            raise FormatError(
                f"{path}: found {num_bytes} bytes, wanted {wanted} for the {header.count} vertices of {record_bytes} bytes "
                f"that its header announces; the file is cut off (or its header lies): read the {whole} whole ones "
                "with repair"
            )
        return whole, {"missing_rows": header.count - whole}
    if header.bytes_after is not None and num_bytes != wanted + header.bytes_after:
        excess = num_bytes - wanted - header.bytes_after
        if not repair:
            raise FormatError(
                f"{path}: found {num_bytes} bytes, {excess} more or less than its header announces "
                f"({header.count} vertices of {record_bytes} bytes); read it with repair to take these vertices alone"
            )
        return header.count, {"unexpected_bytes": abs(excess)}
    return header.count, {}


def _fields(path: Path, header: Header) -> tuple[list[list[str]], int, list[str]]:
    """Properties of each column, the harmonics coefficient by coefficient with RGB inside; their degree; what is left out."""
    names, lost = header.names, []
    if "packed_position" in names:
        raise FormatError(f"{path}: found packed_position beside other elements than those of a compressed .ply")
    if "f_anchor_feat_0" in names:
        raise FormatError(
            f"{path}: found f_anchor_feat: these are anchors of Scaffold-GS or Octree-GS, whose Gaussians a network makes for "
            "each view; wanted Gaussians: bake them with the program that trained them"
        )
    color = _RGB if _DC[0] not in names and _RGB[0] in names else _DC
    missing = [name for name in (*(n for group in _GEOMETRY for n in group), *color) if name not in names]
    geometry: tuple[tuple[str, ...], ...] = _GEOMETRY
    if missing == ["scale_2"]:
        geometry = tuple(tuple("scale_0" if n == "scale_2" else n for n in group) for group in _GEOMETRY)  # a stand-in
    elif missing:
        raise FormatError(
            f"{path}: found no properties {' '.join(missing)} (only {' '.join(list(names)[:12])} …): this is a point cloud "
            "or a mesh, wanted trained Gaussians"
        )
    if missing or header.are_surfels:
        lost.append(
            "the surfels' own rule of drawing (2DGS): they are read as Gaussians, flat ones if they have two scales"
        )
    num_rest = sum(re.fullmatch(r"f_rest_\d+", name) is not None for name in names)
    degree = _NUM_REST.get(num_rest)
    if degree is None or any(f"f_rest_{i}" not in names for i in range(num_rest)):
        raise FormatError(
            f"{path}: found {num_rest} properties f_rest_*, wanted 0, 9, 24, 45 or 72, numbered from 0 (degree 0 to 4)"
        )
    if degree == 4:
        lost.append("the harmonics of degree 4")
    sh = _sh_fields(color, degree, min(degree, 3))
    return [[names[n] for n in group] for group in (*geometry, sh)], min(degree, 3), lost


def _sh_fields(color: tuple[str, ...], degree: int, kept: int) -> list[str]:
    """Properties of the harmonics up to degree ``kept`` in a file of ``degree``, coefficient by coefficient."""
    num_file, num_kept = (degree + 1) ** 2 - 1, (kept + 1) ** 2 - 1
    return [*color, *(f"f_rest_{channel * num_file + j}" for j in range(num_kept) for channel in range(3))]
