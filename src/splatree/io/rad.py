"""``.rad`` (Spark): a tree of Gaussians in compressed chunks of 65,536, the coarsest first, made to be streamed.

``RAD0``, the length of a JSON header, the header, padding to 8 bytes; then the chunks, each ``RADC``, the length of its JSON
header, the header, padding, the bytes of its payload (u8) and the payload: properties, each padded to 8 bytes, mostly deflated.
The header lists the chunks' places and sizes; a chunk's header its properties', with encoding and range
(`splatree.io.rad_properties`). Layout and deviations: docs/formats/rad.md.

The children of a node follow each other: ``child_start``, ``child_count``; node 0 is the root. We write nodes breadth-first, each
level in preorder: coarse chunks come first, and a chunk of a fine level is a run of a Morton curve. Several roots get a node
above them, their moment merge, which a key of our own marks so that reading takes it away again.

In a file with levels, an opacity a above 1 stands for D = 4 a − 3 and an exponent A = e^((D² − 1)/e); see
`splatree.io.opacities`.

Reading goes over the file twice: the links say where each row belongs, so that the other properties are decoded, chunk by chunk
on all processors, into their places.
"""

import json
import zlib
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, BinaryIO, cast

import numpy as np

from splatree.constants import SH_C0
from splatree.errors import FormatError, InputError
from splatree.io import untrusted
from splatree.io.check import checked
from splatree.io.levels import preorder_of_file, scene_with_levels
from splatree.io.opacities import CODE_STEP, areas_of_powers, logits_from_opacities, opacities_from_logits
from splatree.io.options import ReadOptions, WriteOptions
from splatree.io.rad_properties import (
    LOG_SCALE_ZERO,
    check_encoding,
    decode,
    encode_codes,
    encode_floats,
    encode_rotations,
    raw_bytes,
)
from splatree.kernels.cpu import _core
from splatree.kernels.cpu.merge import merge
from splatree.maths.forests import Links, links_from_preorder
from splatree.progress import task
from splatree.scene.gaussians import Gaussians
from splatree.scene.scene import Mode, Scene
from splatree.scene.thinning import Groups, MergeOptions
from splatree.shapes import Array

_MAGIC, _CHUNK_MAGIC = b"RAD0", b"RADC"
_CHUNK_ROWS = 1 << 16
_JSON_MAX = 1 << 24
"""A longer header is refused: a chunk of 65,536 takes 40 bytes of it."""

_ROWS_ALWAYS = 1 << 16
_ROWS_PER_BYTE = 0.25
"""More Gaussians than this for a byte of the file (real ones hold one in 15 to 60) are a decompression bomb, unless they are
few: a Gaussian of degree 3 takes 236 bytes in memory."""

_DEFLATE_LEVEL = 6
_OPAQUE_MAX = 5.0
"""Largest D."""

_RGB_RANGE_MAX = 2.0
"""A chunk whose colours span more is written in half precision instead of 255 steps."""

_LOG_SCALE_RANGE_MAX = 25.0
"""The same of log-scales: 254 steps of a tenth."""


def sniff(path: Path, head: bytes) -> bool:
    """Whether it begins as the format does."""
    return head[:4] == _MAGIC


def read(path: Path, options: ReadOptions) -> Scene:
    """Read all chunks, those in files beside it too; a tree keeps its levels."""
    file = _open(path)
    n = file.count
    gaussians = Gaussians(
        np.empty((n, 3), np.float32),
        np.empty((n, 4), np.float32),
        np.empty((n, 3), np.float32),
        np.empty(n, np.float32),
        np.zeros((n, (file.degree + 1) ** 2, 3), np.float32),
    )
    with task(f"read {path.name}", n) as advance:
        subtree_end, depth, row_from_node = _tree(file)
        palette = _palette(file) if n else None
        num_opaque = 0
        with ThreadPoolExecutor(_core.hardware_threads()) as pool:
            fill = partial(_fill, file, gaussians, palette, row_from_node)
            for chunk, opaque in zip(file.chunks, pool.map(fill, file.chunks), strict=True):
                num_opaque += opaque
                advance(chunk.count)
    if file.joins_roots:
        gaussians = Gaussians(
            *(getattr(gaussians, c)[1:] for c in ("means", "quats", "log_scales", "logit_opacities", "sh"))
        )
        subtree_end, depth = subtree_end[1:] - 1, depth[1:] - np.uint8(1)
    scene = scene_with_levels(
        gaussians, subtree_end, depth, str(path), repair=options.repair, num_opaque=num_opaque, mode=file.mode
    )
    metadata = dict(scene.source.metadata)
    if file.comment:
        metadata["comment"] = file.comment
    return replace(scene, source=replace(scene.source, metadata=metadata))


@dataclass(frozen=True, eq=False)
class _Chunk:
    """A chunk's header, checked."""

    path: Path
    payload: int  # byte of the file
    base: int
    count: int
    properties: dict[str, dict[str, Any]]
    where: str


@dataclass(frozen=True, eq=False)
class _File:
    """The file's header and those of its chunks, checked."""

    where: str
    count: int
    degree: int
    has_levels: bool
    has_lod_opacities: bool
    chunks: list[_Chunk]
    num_codes: int
    mode: Mode
    joins_roots: bool
    comment: str


def _open(path: Path) -> _File:
    where = str(path)
    num_bytes = path.stat().st_size
    with path.open("rb") as file:
        meta, chunks_at = _read_header(file, num_bytes, _MAGIC, where)
        if (version := meta.get("version")) != 1 or (kind := meta.get("type")) != "gsplat":
            found = f"version {version!r}" if version != 1 else f"type {str(kind)[:40]!r}"
            raise FormatError(f"{where}: found {found}, wanted version 1 of type 'gsplat'")
        count = untrusted.integer(meta, "count", where)
        degree = untrusted.integer(meta, "maxSh", where, high=3) if meta.get("maxSh") is not None else 0
        encoding = untrusted.as_object(meta.get("splatEncoding") or {}, f"{where}: splatEncoding")
        ours = untrusted.as_object(meta.get("splatree") or {}, f"{where}: splatree")
        mode = ours.get("mode", "classic")
        if mode not in ("classic", "antialiased"):
            raise FormatError(f"{where}: splatree.mode: found {str(mode)[:40]!r}, wanted 'classic' or 'antialiased'")
        entries = untrusted.as_list(untrusted.field(meta, "chunks", where), f"{where}: chunks")
        chunks, base = [], 0
        for number, entry in enumerate(entries):
            chunk = _open_chunk(path, file, chunks_at, entry, f"{where}: chunk {number}")
            if chunk.base != base:
                raise FormatError(f"{chunk.where}: found base {chunk.base}, wanted {base} after the chunks before it")
            chunks.append(chunk)
            base += chunk.count
            num_bytes += chunk.path.stat().st_size if chunk.path != path else 0
    if base != count:
        raise FormatError(f"{where}: found {base} Gaussians in its chunks, wanted the {count} of its header")
    if count > max(_ROWS_ALWAYS, _ROWS_PER_BYTE * num_bytes):
        raise FormatError(
            f"{where}: found {count} Gaussians in {num_bytes} bytes, wanted at most {_ROWS_PER_BYTE} a byte; the count is wrong "
            "or the file is a decompression bomb"
        )
    num_codes = (
        untrusted.integer(meta, "shCodeCount", where, high=1 << 20) if meta.get("shCodeCount") is not None else 0
    )
    has_levels = meta.get("lodTree") is True
    return _File(
        where=where,
        count=count,
        degree=degree,
        has_levels=has_levels,
        has_lod_opacities=has_levels or encoding.get("lodOpacity") is True,
        chunks=chunks,
        num_codes=num_codes,
        mode=cast(Mode, mode),
        joins_roots=has_levels and count > 0 and ours.get("joinsRoots") is True,
        comment=str(meta.get("comment") or "")[:1000],
    )


def _read_header(file: BinaryIO, num_bytes: int, magic: bytes, where: str) -> tuple[dict[str, Any], int]:
    """The JSON object behind a mark and a length at the current byte, and the byte behind its padding."""
    start = file.tell()
    mark, length = file.read(4), int.from_bytes(file.read(4), "little")
    if mark != magic:
        raise FormatError(f"{where}: found {mark!r}, wanted {magic!r}; the file is damaged or no .rad")
    if length > min(_JSON_MAX, num_bytes - start - 8):
        raise FormatError(
            f"{where}: found a header of {length} bytes in a file of {num_bytes}; it is cut off or damaged"
        )
    meta = untrusted.as_object(untrusted.parse_json(file.read(length), where), where)
    return meta, start + 8 + _padded(length)


def _open_chunk(path: Path, file: BinaryIO, chunks_at: int, entry: Any, where: str) -> _Chunk:
    entry = untrusted.as_object(entry, where)
    offset, size = (untrusted.integer(entry, key, where, high=2**62) for key in ("offset", "bytes"))
    if entry.get("filename") is None:
        return _parse_chunk(path, file, chunks_at + offset, size, where)
    name = untrusted.inner_path(untrusted.text(entry, "filename", where), where)
    beside = path.parent / name
    if not beside.is_file():
        raise FormatError(f"{where}: found no file {beside}, wanted the chunk of that name beside the .rad")
    with beside.open("rb") as other:
        return _parse_chunk(beside, other, offset, size, where)


def _parse_chunk(path: Path, file: BinaryIO, start: int, size: int, where: str) -> _Chunk:
    num_bytes = path.stat().st_size
    if start + size > num_bytes:
        raise FormatError(
            f"{where}: found bytes {start} to {start + size} in a file of {num_bytes}; it is cut off or damaged"
        )
    file.seek(start)
    meta, behind = _read_header(file, start + size, _CHUNK_MAGIC, where)
    if meta.get("version") != 1:
        raise FormatError(f"{where}: found version {str(meta.get('version'))[:40]}, wanted 1")
    base, count = (untrusted.integer(meta, key, where) for key in ("base", "count"))
    payload_bytes = start + size - behind - 8
    properties: dict[str, dict[str, Any]] = {}
    for entry in untrusted.as_list(untrusted.field(meta, "properties", where), where):
        entry = untrusted.as_object(entry, where)
        name = untrusted.text(entry, "property", where)
        check_encoding(name, untrusted.text(entry, "encoding", f"{where}: {name}"), f"{where}: {name}")
        offset, length = (untrusted.integer(entry, key, f"{where}: {name}", high=2**62) for key in ("offset", "bytes"))
        if offset + length > payload_bytes:
            raise FormatError(
                f"{where}: {name}: found bytes {offset} to {offset + length} in a payload of {payload_bytes}; it is damaged"
            )
        if entry.get("compression") not in (None, "gz"):
            raise FormatError(
                f"{where}: {name}: found compression {str(entry['compression'])[:40]!r}, wanted 'gz' or none"
            )
        if name in properties:
            raise FormatError(f"{where}: {name}: found it twice, wanted once")
        properties[name] = entry
    return _Chunk(path, behind + 8, base, count, properties, where)


def _values(chunk: _Chunk, name: str, num_rows: int | None = None) -> Array:
    """Values "n d" of a property, inflated to the size that its encoding has and no further."""
    entry, where = chunk.properties[name], f"{chunk.where}: {name}"
    num_rows = chunk.count if num_rows is None else num_rows
    wanted = raw_bytes(name, entry["encoding"], num_rows)
    with chunk.path.open("rb") as file:
        file.seek(chunk.payload + int(entry["offset"]))
        data = file.read(int(entry["bytes"]))
    if entry.get("compression") == "gz":
        try:
            data = zlib.decompressobj(-zlib.MAX_WBITS).decompress(data, wanted + 1)
        except zlib.error as error:
            raise FormatError(f"{where}: cannot be inflated ({error}); the file is damaged") from error
    if len(data) != wanted:
        found = f"{len(data)} bytes" if len(data) < wanted else f"more than {wanted} bytes"
        raise FormatError(f"{where}: found {found}, wanted {wanted} for {num_rows} rows of {entry['encoding']}")
    return decode(name, entry["encoding"], data, num_rows, entry, where)


def _tree(file: _File) -> tuple[Array, Array, Array]:
    """Subtree end and depth of each row, and the row of each node."""
    n = file.count
    if not file.has_levels or n == 0:
        return np.arange(1, n + 1, dtype=np.int32), np.zeros(n, np.uint8), np.arange(n, dtype=np.int32)
    links = np.empty((2, n), np.int64)
    for chunk in file.chunks:
        for link, name in zip(links, ("child_start", "child_count"), strict=True):
            if name not in chunk.properties:
                raise FormatError(f"{chunk.where}: found no {name}, wanted it in a file with a tree")
            link[chunk.base : chunk.base + chunk.count] = _values(chunk, name)[:, 0]
    order = preorder_of_file(links[0], links[1], np.zeros(1, np.int32), file.where)
    row_from_node = np.empty(n, np.int32)
    row_from_node[order.node_from_row] = np.arange(n, dtype=np.int32)
    return order.subtree_end, order.depth, row_from_node


def _palette(file: _File) -> Array | None:
    """Harmonics beyond the DC of each label "p 3K"; None if the file has no palette. The first chunk holds it."""
    first = file.chunks[0]
    if file.degree == 0 or "sh1_code" not in first.properties:
        return None
    names = [f"sh{order}_code" for order in range(1, file.degree + 1)]
    missing = [name for name in names if name not in first.properties]
    if missing or file.num_codes == 0:
        raise FormatError(
            f"{first.where}: found no {(missing or ['shCodeCount'])[0]}, wanted a palette of degree {file.degree}"
        )
    return np.concatenate([_values(first, name, file.num_codes) for name in names], axis=1)


def _fill(file: _File, g: Gaussians, palette: Array | None, row_from_node: Array, chunk: _Chunk) -> int:
    """Decode a chunk into its rows; return how many of its opacities were above 1."""
    missing = [name for name in ("center", "alpha", "rgb", "scales", "orientation") if name not in chunk.properties]
    if missing:
        raise FormatError(f"{chunk.where}: found no {missing[0]}, wanted it in every chunk")
    nodes = slice(chunk.base, chunk.base + chunk.count)
    rows = row_from_node[nodes] if file.has_levels else nodes
    g.means[rows] = _values(chunk, "center")
    g.quats[rows] = _values(chunk, "orientation")
    g.sh[rows, 0] = (_values(chunk, "rgb") - np.float32(0.5)) / np.float32(SH_C0)
    log_scales, alphas = _values(chunk, "scales"), _values(chunk, "alpha")[:, 0]
    num_opaque = 0
    if file.has_lod_opacities:
        above = np.flatnonzero(alphas > 1)
        num_opaque = len(above)
        d = np.minimum(4 * alphas[above].astype(np.float64) - 3, _OPAQUE_MAX)
        log_scales[above] += 0.5 * np.log(areas_of_powers(np.exp((d * d - 1) / np.e)))[:, None]
    g.log_scales[rows] = log_scales
    steps = {"f32": (2.0**-148, 2.0**-24), "f16": (2.0**-24, 2.0**-11)}
    step_low, step_high = steps.get(chunk.properties["alpha"]["encoding"], (CODE_STEP, CODE_STEP))
    g.logit_opacities[rows] = logits_from_opacities(alphas, step_low=step_low, step_high=step_high)

    rest = g.sh.reshape(len(g), -1)
    if palette is not None:
        if "sh_label" not in chunk.properties:
            raise FormatError(f"{chunk.where}: found no sh_label, wanted one for the palette of the first chunk")
        labels = _values(chunk, "sh_label")[:, 0]
        if len(labels) and int(labels.max()) >= len(palette):
            raise FormatError(
                f"{chunk.where}: sh_label: found {labels.max()}, wanted less than the {len(palette)} entries"
            )
        rest[rows, 3:] = palette[labels]
        return num_opaque
    for order in range(1, file.degree + 1):
        name = f"sh{order}"
        if name not in chunk.properties:
            raise FormatError(f"{chunk.where}: found no {name}, wanted harmonics of degree {file.degree}")
        rest[rows, 3 * order * order : 3 * (order + 1) ** 2] = _values(chunk, name)
    return num_opaque


def write(scene: Scene, path: Path, options: WriteOptions) -> tuple[str, ...]:
    """Write with the tree, breadth-first: 8 bits as Spark does (compression 2, the default), half precision (1) or floats (0).

    Raises:
        InputError: a node has more than 65,535 children.
    """
    level = 2 if options.compression is None else options.compression
    if level not in (0, 1, 2):
        raise InputError(f"{path.name}: found compression {level}, wanted 0 (floats), 1 (half precision) or 2 (8 bits)")
    scene = checked(scene, "scene to write", repair=False)
    g, n = scene.gaussians, len(scene)
    has_levels = scene.tree.num_leaves < n
    links = links_from_preorder(scene.tree.depth) if has_levels else None
    num_roots = int(np.count_nonzero(scene.tree.depth == 0))
    joins_roots = has_levels and num_roots > 1
    root = _joined_root(g, np.flatnonzero(scene.tree.depth == 0)) if joins_roots else Gaussians.empty(g.sh_degree)
    above = len(root)  # nodes before those of the scene
    largest_family = max(num_roots if joins_roots else 0, int(links.num_children.max()) if links else 0)
    if largest_family > 65535:
        raise InputError(
            f"{path.name}: found a node of {largest_family} children, wanted at most 65535; build the levels with a smaller "
            "growth or fewer roots"
        )
    starts = range(0, n + above, _CHUNK_ROWS)
    # Offsets are known when the chunks are; their list is padded with spaces to this size.
    header_bytes = _padded(1000 + 44 * len(starts))
    entries: list[dict[str, int]] = []
    with path.open("wb") as file, task(f"write {path.name}", n) as advance:
        file.seek(8 + header_bytes)
        with ThreadPoolExecutor(_core.hardware_threads()) as pool:
            encode = partial(_encode_chunk, g, root, links, joins_roots, level)
            offset = 0
            for chunk in pool.map(encode, starts):
                file.write(chunk)
                entries.append({"offset": offset, "bytes": len(chunk)})
                offset += len(chunk)
                advance(_CHUNK_ROWS)
        meta: dict[str, Any] = {"version": 1, "type": "gsplat", "count": n + above, "maxSh": g.sh_degree}
        meta |= {"lodTree": True} if has_levels else {}
        meta |= {"chunkSize": _CHUNK_ROWS, "allChunkBytes": offset, "chunks": entries}
        meta |= {"splatEncoding": _display_ranges(g, has_levels), "comment": "written by splatree"}
        meta |= {"splatree": {"mode": scene.mode, "joinsRoots": joins_roots}}
        text = json.dumps(meta, separators=(",", ":")).encode()
        assert len(text) <= header_bytes
        file.seek(0)
        file.write(_MAGIC + header_bytes.to_bytes(4, "little") + text.ljust(header_bytes))
    return ()


def _joined_root(g: Gaussians, roots: Array) -> Gaussians:
    """The moment merge of the roots, weighted by opacity."""
    members = g.take(roots)
    every = np.arange(len(roots), dtype=np.int32)
    groups = Groups(every[:1], np.zeros_like(every), np.array([0, len(roots)], np.int64), every)
    weights = np.maximum(opacities_from_logits(members.logit_opacities), np.float32(1e-6))
    return merge(members, groups, weights, MergeOptions(weight="opacity", opacity="standard"))


def _encode_chunk(
    g: Gaussians, root: Gaussians, links: Links | None, joins_roots: bool, level: int, begin: int
) -> bytes:
    above, n = len(root), len(g)
    end = min(begin + _CHUNK_ROWS, n + above)
    nodes = np.arange(max(begin - above, 0), end - above)  # of the scene
    part = g.take(nodes if links is None else links.row_from_node[nodes])
    if begin == 0 and above:
        part = Gaussians.concatenate([root, part])
    properties = list(_encoded(part, level))
    if links is not None:
        first, count = links.first_child[nodes] + above, links.num_children[nodes]
        first[count == 0] = 0
        if begin == 0 and above:
            num_roots = int(np.searchsorted(links.parents >= 0, True))
            first, count = np.append(1, first), np.append(num_roots, count)
        properties.append(({"property": "child_count", "encoding": "u16"}, count.astype("<u2").tobytes()))
        properties.append(({"property": "child_start", "encoding": "u32"}, first.astype("<u4").tobytes()))
    payload = bytearray()
    for entry, data in properties:
        deflate = zlib.compressobj(_DEFLATE_LEVEL, zlib.DEFLATED, -zlib.MAX_WBITS)
        packed = deflate.compress(data) + deflate.flush()
        entry |= {"offset": len(payload), "bytes": len(packed), "compression": "gz"}
        payload += packed.ljust(_padded(len(packed)), b"\0")
    meta: dict[str, Any] = {
        "version": 1,
        "base": begin,
        "count": end - begin,
        "payloadBytes": len(payload),
        "maxSh": g.sh_degree,
    }
    meta |= {"lodTree": True} if links is not None else {}
    meta |= {"properties": [entry for entry, _ in properties]}
    text = json.dumps(meta, separators=(",", ":")).encode()
    header = _CHUNK_MAGIC + len(text).to_bytes(4, "little") + text.ljust(_padded(len(text)), b"\0")
    return header + len(payload).to_bytes(8, "little") + bytes(payload)


def _encoded(g: Gaussians, level: int) -> Iterator[tuple[dict[str, Any], bytes]]:
    """Properties of a chunk with their encoding and range, before compression."""
    wide = "f32" if level == 0 else "f16"
    yield {"property": "center", "encoding": "f32_lebytes"}, encode_floats(g.means, "f32_lebytes")
    opacities = opacities_from_logits(g.logit_opacities)[:, None]
    yield {"property": "alpha", "encoding": wide}, encode_floats(opacities, wide)

    rgb = np.float32(0.5) + np.float32(SH_C0) * g.sh[:, 0]
    low, high = _range(rgb)
    if level == 2 and high - low <= _RGB_RANGE_MAX:
        entry = {"property": "rgb", "encoding": "r8_delta", "min": low, "max": high}
        yield entry, encode_codes(rgb, low, high, steps=255, delta=True)
    else:
        yield {"property": "rgb", "encoding": wide}, encode_floats(rgb, wide)

    log_scales = np.maximum(g.log_scales, np.float32(LOG_SCALE_ZERO))
    low, high = _range(log_scales)
    if level == 0:
        yield {"property": "scales", "encoding": "f32"}, encode_floats(np.exp(log_scales), "f32")
    elif level == 1 or high - low > _LOG_SCALE_RANGE_MAX:
        yield {"property": "scales", "encoding": "ln_f16"}, encode_floats(log_scales, "ln_f16")
    else:
        entry = {"property": "scales", "encoding": "ln_0r8", "min": low, "max": high}
        yield entry, encode_codes(log_scales, low, high, steps=254, first=1)

    if level == 2:
        yield {"property": "orientation", "encoding": "oct88r8"}, encode_rotations(g.quats)
    else:
        quats = g.quats / np.linalg.norm(g.quats.astype(np.float64), axis=1, keepdims=True)
        quats *= np.where(quats[:, :1] < 0, -1, 1)  # w follows from the length
        yield {"property": "orientation", "encoding": "f32"}, encode_floats(quats[:, 1:], "f32")

    rest = g.sh.reshape(len(g), -1)
    for order in range(1, g.sh_degree + 1):
        name, values = f"sh{order}", rest[:, 3 * order * order : 3 * (order + 1) ** 2]
        if level == 2:
            high = max(float(values.max(initial=0)), -float(values.min(initial=0))) or 1.0
            entry = {"property": name, "encoding": "s8", "min": -high, "max": high}
            codes = np.rint(values * np.float32(127 / high)).astype(np.int8)
            yield entry, np.ascontiguousarray(codes.T).tobytes()
        else:
            yield {"property": name, "encoding": wide}, encode_floats(values, wide)


def _range(values: Array) -> tuple[float, float]:
    """Least and largest value, apart from each other."""
    low, high = float(values.min()), float(values.max())
    return (low, high) if high > low else (low, float(np.nextafter(np.float32(low), np.float32(np.inf))) + 1e-3)


def _display_ranges(g: Gaussians, has_levels: bool) -> dict[str, Any]:
    """Ranges to which a viewer that keeps 8 bits in memory should spread values: the middle 98 % of a sample, as Spark's."""
    rows = slice(None, None, max(1, len(g) // 65536))

    def middle(values: Array) -> tuple[float, float]:
        low, high = np.quantile(values, (0.01, 0.99)) if values.size else (0, 0)
        return float(low), float(high)

    rgb = middle(0.5 + SH_C0 * g.sh[rows, 0])
    log_scales = middle(g.log_scales[rows])
    ranges: dict[str, Any] = {"rgbMin": min(0.0, rgb[0]), "rgbMax": max(1.0, rgb[1])}
    ranges |= {"lnScaleMin": min(-12.0, log_scales[0]), "lnScaleMax": max(9.0, log_scales[1])}
    for order in range(1, 4):
        rest = middle(g.sh[rows, order * order : (order + 1) ** 2])
        ranges[f"sh{order}Max"] = max(1.0, -rest[0], rest[1])
    return ranges | {"lodOpacity": has_levels}


def _padded(num_bytes: int) -> int:
    return -(-num_bytes // 8) * 8
