"""3DGS ``.ply``: the file that training writes (Kerbl 2023), one float32 record a Gaussian.

``x y z nx ny nz f_dc_0..2 f_rest_0..3K-1 opacity scale_0..2 rot_0..3``, binary little-endian, K = 0, 3, 8, 15 harmonics a
channel beyond the DC. ``f_rest`` is channel-major: all K of red, then of green, then of blue; scales are natural logarithms,
opacity is a logit, the quaternion is wxyz and need not have length one. Layout and deviations: docs/reference/formats/ply.md.

Reading goes by name (ply/properties.py), so properties may come in any order and as any scalar type (ply/vertices.py).
"""

from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

import numpy as np

from splatree.io.check import checked, checked_rows
from splatree.io.chunks import ROWS_PER_CHUNK, Chunks, counted_chunks
from splatree.io.formats.ply.properties import DC, GEOMETRY, NORMALS, sh_fields
from splatree.io.formats.ply.vertices import COLUMNS, gaussians_of, open_vertices
from splatree.io.options import ReadOptions, WriteOptions
from splatree.kernels.cpu.codec.columns import interleave
from splatree.kernels.cpu.runtime.files import reserve
from splatree.progress import task
from splatree.scene.gaussians import Gaussians
from splatree.scene.origin import NO_ORIGIN
from splatree.scene.scene import Scene, Source


def sniff(path: Path, head: bytes) -> bool:
    """Whether the file is a .ply of any kind."""
    return head[:4] in (b"ply\n", b"ply\r")


def read(path: Path, options: ReadOptions) -> Scene:
    """Read a 3DGS .ply.

    Normals are dropped; other properties that are not of 3DGS are named in the metadata (`lost`, `extra_properties`), or refused
    where the picture would be wrong without them; a 3D filter is fused, harmonics of degree 4 are cut off, surfels read as flat
    Gaussians, coordinates in double precision taken relative to an origin where they lie far off: the metadata says so.
    """
    ply = open_vertices(path, options)
    columns = ply.buffers(ply.num_rows)
    with path.open("rb") as file, task(f"read {path.name}", ply.num_rows) as advance:
        magnitudes = ply.fill(file, ply.lines(file), 0, columns)
        advance(ply.num_rows)
    source = Source(metadata=ply.metadata, origin=ply.origin)
    scene = Scene.flat(gaussians_of(columns), mode=ply.header.mode, source=source)
    return checked(scene, str(path), repair=options.repair, magnitudes=magnitudes)


def read_chunks(path: Path, options: ReadOptions) -> Chunks:
    """Open a 3DGS .ply to be read in chunks: the same values, in buffers that are used again."""
    ply = open_vertices(path, options)

    def parts() -> Iterator[tuple[Gaussians, dict[str, int]]]:
        buffers = ply.buffers(min(ROWS_PER_CHUNK, ply.num_rows))
        with path.open("rb") as file:
            lines = ply.lines(file)
            for begin in range(0, ply.num_rows, ROWS_PER_CHUNK):
                columns = [buffer[: ply.num_rows - begin] for buffer in buffers]
                magnitudes = ply.fill(file, lines, begin, columns)
                yield checked_rows(
                    gaussians_of(columns), str(path), repair=options.repair, magnitudes=magnitudes, first_row=begin
                )

    rows, degree, mode = ply.num_rows, ply.fields.degree, ply.header.mode
    drops_rows = bool(options.repair)
    return counted_chunks(parts, rows, degree, mode, ply.metadata, drops_rows=drops_rows, origin=ply.origin)


def write_chunks(chunks: Chunks, path: Path, options: WriteOptions) -> tuple[str, ...]:
    """Write the layout of the 3DGS code, zero normals included; every value keeps its bits.

    A scene with an origin gets x, y, z in double precision and in the world's coordinates.
    """
    rest = [f"f_rest_{i}" for i in range(3 * ((chunks.sh_degree + 1) ** 2 - 1))]
    means, quats, log_scales, logits = GEOMETRY
    names = [*means, *NORMALS, *DC, *rest, *logits, *log_scales, *quats]
    fields = [*GEOMETRY, sh_fields(DC, chunks.sh_degree, chunks.sh_degree)]
    lines = ["ply", "format binary_little_endian 1.0"]
    if chunks.mode == "antialiased":
        lines.append("comment SplatRenderMode: mip")
    is_far = chunks.origin != NO_ORIGIN
    kinds = {name: ("double", "<f8") if is_far and name in means else ("float", "<f4") for name in names}
    lines += [
        f"element vertex {len(chunks)}",
        *(f"property {kinds[name][0]} {name}" for name in names),
        "end_header",
        "",
    ]
    records = np.zeros(0, [(name, kinds[name][1]) for name in names])
    with path.open("wb", buffering=0) as file, task(f"write {path.name}", len(chunks)) as advance:
        header = "\n".join(lines).encode()
        reserve(file, len(header) + len(chunks) * records.itemsize)
        _write_all(file, memoryview(header))
        for g in chunks:
            if len(records) < len(g):
                records = np.zeros(len(g), records.dtype)
            columns = [getattr(g, name).reshape(len(g), len(f)) for name, f in zip(COLUMNS, fields, strict=True)]
            interleave(columns[is_far:], fields[is_far:], records)
            if is_far:
                for axis, name in enumerate(means):
                    records[name][: len(g)] = g.means[:, axis].astype(np.float64) + chunks.origin[axis]
            _write_all(file, records[: len(g)].view(np.uint8).data)
            advance(len(g))
    return ()


def _write_all(file: BinaryIO, data: memoryview) -> None:
    """All bytes: an unbuffered write may take a part of them."""
    while len(data):
        data = data[file.write(data) :]
