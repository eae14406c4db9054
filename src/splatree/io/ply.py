"""3DGS ``.ply``: the file that training writes (Kerbl 2023), one float32 record a Gaussian.

``x y z nx ny nz f_dc_0..2 f_rest_0..3K-1 opacity scale_0..2 rot_0..3``, binary little-endian, K = 0, 3, 8, 15 harmonics a
channel beyond the DC. ``f_rest`` is channel-major: all K of red, then of green, then of blue; scales are natural logarithms,
opacity is a logit, the quaternion is wxyz and need not have length one. Layout and deviations: docs/formats/ply.md.

Reading goes by name, so properties may come in any order and as any scalar type. One native pass reads the file chunk by
chunk and takes it apart in the cache: no copy of the file is ever in memory, and the cost is about that of reading it once.
"""

import json
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from splatree.constants import SH_C0
from splatree.errors import FormatError
from splatree.io.check import checked
from splatree.io.chunks import Chunks
from splatree.io.options import ReadOptions, WriteOptions
from splatree.kernels.cpu.columns import deinterleave, largest_magnitude
from splatree.progress import task
from splatree.scene.gaussians import Gaussians
from splatree.scene.scene import Mode, Scene, Source

_HEADER_MAX = 1 << 20
"""A longer header is refused: 62 properties take 1.5 kB."""

_TYPES = {
    **dict.fromkeys(("char", "int8"), "<i1"),
    **dict.fromkeys(("uchar", "uint8"), "<u1"),
    **dict.fromkeys(("short", "int16"), "<i2"),
    **dict.fromkeys(("ushort", "uint16"), "<u2"),
    **dict.fromkeys(("int", "int32"), "<i4"),
    **dict.fromkeys(("uint", "uint32"), "<u4"),
    **dict.fromkeys(("float", "float32"), "<f4"),
    **dict.fromkeys(("double", "float64"), "<f8"),
}

_GEOMETRY = (
    ("x", "y", "z"),
    ("rot_0", "rot_1", "rot_2", "rot_3"),
    ("scale_0", "scale_1", "scale_2"),
    ("opacity",),
)
"""Properties of the columns means, quats, log_scales, logit_opacities."""

_DC = ("f_dc_0", "f_dc_1", "f_dc_2")
_RGB = ("red", "green", "blue")
_NORMALS = ("nx", "ny", "nz")


def sniff(path: Path, head: bytes) -> bool:
    """Whether the file is a .ply of any kind."""
    return head[:4] in (b"ply\n", b"ply\r")


def read(path: Path, options: ReadOptions) -> Scene:
    """Read a 3DGS .ply of degree 0 to 3.

    Normals are dropped; other properties that are not of 3DGS are dropped and named in the metadata (`extra_properties`).
    """
    with path.open("rb") as file:
        header = _parse_header(path, file.read(_HEADER_MAX))
        num_bytes = path.stat().st_size
        num_rows, repairs = _check_size(path, header, num_bytes, repair=options.repair)
        fields, degree = _fields(path, header)
        columns = [np.empty((num_rows, len(names)), np.float32) for names in fields]
        with task(f"read {path.name}", num_rows) as advance:
            try:
                magnitudes = deinterleave(file, header.start, header.dtype, fields, columns)
            except EOFError as error:
                raise FormatError(f"{path}: cannot be read to its end ({error}); did it change meanwhile?") from error
            advance(num_rows)
    means, quats, log_scales, logits, harmonics = columns
    sh = harmonics.reshape(num_rows, (degree + 1) ** 2, 3)
    if "f_dc_0" not in header.names:  # RGB of 8 bits, or 0 to 1: the inverse of colour = ½ + C0 dc
        is_bytes = header.dtype[header.names["red"]].kind in "iu"
        sh[:, 0] = (sh[:, 0] / np.float32(255 if is_bytes else 1) - np.float32(0.5)) / np.float32(SH_C0)

    used = {name for names in fields for name in names} | {header.names.get(n) for n in _NORMALS}
    extra = [name for name in header.dtype.names or () if name not in used]
    metadata = {}
    if extra:
        metadata["extra_properties"] = json.dumps(extra)
    if header.comments:
        metadata["comments"] = json.dumps(header.comments)
    if repairs:
        metadata["repairs"] = json.dumps(repairs)
    gaussians = Gaussians(means, quats, log_scales, logits.reshape(-1), sh)
    scene = Scene.flat(gaussians, mode=header.mode, source=Source(metadata=metadata))
    known = dict(zip(("means", "quats", "log_scales", "logit_opacities", "sh"), magnitudes, strict=True))
    if "f_dc_0" not in header.names:
        known["sh"] = largest_magnitude(gaussians.sh)  # the colours were converted after they were measured
    return checked(scene, str(path), repair=options.repair, magnitudes=known)


def write_chunks(chunks: Chunks, path: Path, options: WriteOptions) -> tuple[str, ...]:
    """Write the layout of the 3DGS code, zero normals included; every value keeps its bits."""
    num_rest = 3 * ((chunks.sh_degree + 1) ** 2 - 1)
    names = ["x", "y", "z", *_NORMALS, *_DC, *(f"f_rest_{i}" for i in range(num_rest)), "opacity"]
    names += ["scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"]
    lines = ["ply", "format binary_little_endian 1.0"]
    if chunks.mode == "antialiased":
        lines.append("comment SplatRenderMode: mip")
    lines += [f"element vertex {len(chunks)}", *(f"property float {name}" for name in names), "end_header", ""]
    with path.open("wb") as file, task(f"write {path.name}", len(chunks)) as advance:
        file.write("\n".join(lines).encode())
        for g in chunks:
            records = np.zeros((len(g), len(names)), "<f4")
            records[:, 0:3] = g.means
            records[:, 6:9] = g.sh[:, 0]
            rest = g.sh[:, 1:].transpose(0, 2, 1)  # [n 3 K]: channel-major
            records[:, 9 : 9 + num_rest] = rest.reshape(len(g), num_rest)
            records[:, -8] = g.logit_opacities
            records[:, -7:-4] = g.log_scales
            records[:, -4:] = g.quats
            file.write(records.data)
            advance(len(g))
    return ()


@dataclass(frozen=True)
class _Header:
    start: int  # byte of the first vertex
    count: int
    dtype: np.dtype[np.void]  # of a vertex
    names: dict[str, str]  # property by its bare name: CloudCompare writes scalar_opacity for opacity
    bytes_after: int | None  # of the elements behind the vertices; None if they hold lists
    mode: Mode
    comments: list[str]


def _parse_header(path: Path, head: bytes) -> _Header:
    match = re.search(rb"(?:^|\n)end_header[ \t]*\r?\n", head)
    if not match:
        raise FormatError(f"{path}: found no end_header in its first {len(head)} bytes; the file is damaged or cut off")
    try:
        lines = [line.strip() for line in head[: match.start()].decode("utf-8").splitlines()]
    except UnicodeDecodeError as error:
        raise FormatError(f"{path}: the header is not text ({error}); the file is damaged") from error

    encoding = ""
    comments: list[str] = []
    elements: list[tuple[str, int, list[tuple[str, str]], bool]] = []  # name, count, properties, whether it has lists
    for line_number, line in enumerate(lines[1:], start=2):
        where = f"{path}: line {line_number} of the header, {line!r}"
        match line.split():
            case []:
                pass
            case ["comment" | "obj_info", *_]:
                comments.append(line.partition(" ")[2])
            case ["format", encoding, *_]:
                pass
            case ["element", name, digits] if digits.isascii() and digits.isdigit() and len(digits) < 16:
                elements.append((name, int(digits), [], False))
            case ["property", "list", _, _, _] if elements:
                name, size, properties, _ = elements[-1]
                elements[-1] = (name, size, properties, True)
            case ["property", kind, name] if elements and kind in _TYPES:
                elements[-1][2].append((name, _TYPES[kind]))
            case _:
                raise FormatError(f"{where}: wanted 'element NAME COUNT' or 'property TYPE NAME' with a scalar type")
    if encoding != "binary_little_endian":
        raise FormatError(
            f"{path}: found format {encoding or 'missing'!r}, wanted 'binary_little_endian'; save it as binary, "
            "for example with splat-transform or CloudCompare"
        )

    start = match.end()
    for index, (name, count, properties, has_lists) in enumerate(elements):
        names = [n for n, _ in properties]
        if len(set(names)) != len(names):
            raise FormatError(f"{path}: element {name!r} has two properties of the same name")
        dtype = np.dtype(properties)
        if name == "vertex":
            if has_lists:
                raise FormatError(f"{path}: the vertices hold lists, wanted scalars: this is no 3DGS file")
            after = elements[index + 1 :]
            bytes_after = None if any(e[3] for e in after) else sum(e[1] * np.dtype(e[2]).itemsize for e in after)
            bare = {n.removeprefix("scalar_"): n for n in names} | {n: n for n in names}
            mode, rest = _mode_from_comments(path, comments)
            return _Header(start, count, dtype, bare, bytes_after, mode, rest)
        if has_lists:
            raise FormatError(f"{path}: element {name!r} before the vertices holds lists: this is no 3DGS file")
        start += count * dtype.itemsize
    raise FormatError(f"{path}: found elements {[e[0] for e in elements]}, wanted one named 'vertex'")


def _mode_from_comments(path: Path, comments: list[str]) -> tuple[Mode, list[str]]:
    """The mode that Brush and splat-transform (SplatRenderMode) or Postshot (antialiased 0/1) note; the other comments."""
    mode: Mode = "classic"
    rest = []
    for comment in comments:
        match comment.lower().split():
            case ["splatrendermode:", "default"] | ["antialiased", "0"]:
                mode = "classic"
            case ["splatrendermode:", "mip"] | ["antialiased", "1"]:
                mode = "antialiased"
            case ["splatrendermode:", other, *_]:
                raise FormatError(
                    f"{path}: found SplatRenderMode {other!r}, wanted 'default' or 'mip'; "
                    "surfels (2dgs) are drawn by another rule than Gaussians"
                )
            case _:
                rest.append(comment)
    return mode, rest


def _check_size(path: Path, header: _Header, num_bytes: int, *, repair: bool) -> tuple[int, dict[str, int]]:
    """Rows to read, and repairs done: the vertices must fill the file to its end, but for other elements behind them."""
    record_bytes = header.dtype.itemsize
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


def _fields(path: Path, header: _Header) -> tuple[list[list[str]], int]:
    """Properties of each column, the harmonics coefficient by coefficient with RGB inside; and their degree."""
    names = header.names
    if "packed_position" in names:
        raise FormatError(
            f"{path}: found packed_position, the compressed .ply of PlayCanvas, wanted float properties; "
            "unpack it with splat-transform"
        )
    color = _RGB if _DC[0] not in names and _RGB[0] in names else _DC
    missing = [name for name in (*(n for group in _GEOMETRY for n in group), *color) if name not in names]
    if missing == ["scale_2"]:
        raise FormatError(
            f"{path}: found no property scale_2: these are surfels (2DGS), wanted Gaussians with three scales"
        )
    if missing:
        raise FormatError(
            f"{path}: found no properties {' '.join(missing)} (only {' '.join(list(names)[:12])} …): this is a point cloud "
            "or a mesh, wanted trained Gaussians"
        )
    num_rest = sum(re.fullmatch(r"f_rest_\d+", name) is not None for name in names)
    degree = {0: 0, 9: 1, 24: 2, 45: 3}.get(num_rest)
    if degree is None or any(f"f_rest_{i}" not in names for i in range(num_rest)):
        raise FormatError(
            f"{path}: found {num_rest} properties f_rest_*, wanted 0, 9, 24 or 45, numbered from 0 (degree 0 to 3)"
        )
    per_channel = num_rest // 3
    rest = [f"f_rest_{channel * per_channel + j}" for j in range(per_channel) for channel in range(3)]
    return [[names[n] for n in group] for group in (*_GEOMETRY, (*color, *rest))], degree
