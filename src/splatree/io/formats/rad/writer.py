"""Write ``.rad``: nodes in Spark's order (`rad/nodes.py`), in chunks of 65,536 whose properties are deflated on a processor each.

The header stands before the chunks but lists their places; it is written last, into the room kept for it, padded with spaces.
Ranges of 8-bit codes are those of each chunk: nothing is clipped, and a chunk of small Gaussians has small steps.
"""

import json
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from splatree.constants import ALPHA_THRESHOLD, SH_C0
from splatree.errors import InputError
from splatree.io.check import refuse_unusable
from splatree.io.chunks import Chunks, chunks_of
from splatree.io.formats.rad.container import CHUNK_MAGIC, MAGIC, padded
from splatree.io.formats.rad.nodes import Links, Nodes, nodes_of
from splatree.io.formats.rad.properties import HALF_MAX, LOG_SCALE_ZERO, encode_codes, encode_floats, encode_rotations
from splatree.io.notes import gaussians_in_words
from splatree.io.opacities import opacities_from_logits
from splatree.io.options import WriteOptions
from splatree.io.rows import regrouped
from splatree.kernels.cpu import _core
from splatree.kernels.cpu.codec.paging import PAGE_ROWS
from splatree.progress import task
from splatree.scene.gaussians import Gaussians
from splatree.scene.levels import LevelRecord
from splatree.scene.names import Mode
from splatree.scene.scene import Scene
from splatree.shapes import Array

if TYPE_CHECKING:
    from concurrent.futures import ThreadPoolExecutor

_CHUNK_ROWS = PAGE_ROWS
_SAMPLE = 1 << 14
"""Rows of which the ranges for display are taken."""

_ROWS_AT_ONCE = 1 << 12
"""What lies between values and codes of so many rows stays in the second-level cache."""

_RUNS = (1, zlib.Z_RLE)
_DEFLATE = dict.fromkeys(("scales", "orientation", "sh1", "sh2", "sh3"), _RUNS)
_DEFLATE_OTHERS = (4, zlib.Z_DEFAULT_STRATEGY)
"""Level and strategy of zlib. Codes of scales, rotations and harmonics hardly repeat but for runs of one value: on a million
Gaussians of a city looking for more makes them 4 % larger, since matches cost more than they save, and takes 2.4 times as long.
Level 4 in place of 6 makes the others no larger."""

_RGB_RANGE_MAX = 2.0
"""A chunk whose colours span more is written in half precision instead of 255 steps."""

_LOG_SCALE_RANGE_MAX = 25.0
"""The same of log-scales: 254 steps of a tenth."""


def write(scene: Scene, path: Path, options: WriteOptions) -> tuple[str, ...]:
    """Write with the tree: 8 bits as Spark does (compression 2, the default), half precision (1) or floats (0).

    Raises:
        InputError: a node has more than 65,535 children.
    """
    g, n = scene.gaussians, len(scene)
    if scene.tree.num_leaves == n:
        return _write(path, _Head(n, g.sh_degree, scene.mode, scene.threshold), _parts(chunks_of(scene)), options)
    head, parts = _with_levels(scene, path)
    return _write(path, head, parts, options)


def write_chunked(scene: Scene, path: Path, write_chunk: Callable[[int, bytes], str]) -> None:
    """Write a scene with levels as a header alone, and give ``write_chunk`` each chunk with its number, which names its file.

    Raises:
        InputError: a node has more than 65,535 children.
    """
    head, parts = _with_levels(scene, path)
    encoder = _Encoder(head, WriteOptions(), path.name)
    entries = [
        {"offset": 0, "bytes": len(chunk), "filename": write_chunk(number, chunk)}
        for number, chunk in enumerate(encoder.chunks(parts))
    ]
    text = encoder.header(entries)
    path.write_bytes(MAGIC + len(text).to_bytes(4, "little") + text.ljust(padded(len(text)), b"\0"))


def _with_levels(scene: Scene, path: Path) -> tuple["_Head", Iterator[Gaussians]]:
    refuse_unusable(scene.gaussians, "scene to write")
    nodes = nodes_of(scene, path)
    parts = (nodes.gaussians(scene, b, b + _CHUNK_ROWS) for b in range(0, len(nodes), _CHUNK_ROWS))
    degree = scene.gaussians.sh_degree
    return _Head(len(nodes), degree, scene.mode, scene.threshold, nodes, scene.tree.record), parts


def write_chunks(chunks: Chunks, path: Path, options: WriteOptions) -> tuple[str, ...]:
    """The same of a scene without levels."""
    head = _Head(len(chunks), chunks.sh_degree, chunks.mode, ALPHA_THRESHOLD)
    return _write(path, head, _parts(chunks), options)


def _parts(chunks: Chunks) -> Iterator[Gaussians]:
    """All rows, checked, as many at a time as the file's chunks have; a part is valid until the next is asked for."""
    return regrouped(_checked(chunks), min(_CHUNK_ROWS, len(chunks)), chunks.sh_degree)


def _checked(chunks: Chunks) -> Iterator[Gaussians]:
    begin = 0
    for g in chunks:
        refuse_unusable(g, "scene to write", first_row=begin)
        begin += len(g)
        yield g


@dataclass(frozen=True, eq=False)
class _Head:
    """What is said of all chunks."""

    count: int
    sh_degree: int
    mode: Mode
    threshold: float
    nodes: Nodes | None = None
    record: LevelRecord | None = None

    @property
    def ours(self) -> dict[str, Any]:
        """What the header says for splatree alone."""
        levels = {} if self.record is None else {"levels": json.loads(self.record.to_json())}
        joins_roots = self.nodes is not None and len(self.nodes.joined_root) > 0
        return {"mode": self.mode, "threshold": self.threshold, "joinsRoots": joins_roots, **levels}


def _write(path: Path, head: _Head, parts: Iterator[Gaussians], options: WriteOptions) -> tuple[str, ...]:
    """Write the Gaussians and their links part by part, and then the header before them; return what was clamped."""
    encoder = _Encoder(head, options, path.name)
    # Offsets are known when the chunks are; their list is padded with spaces to this size.
    header_bytes = padded(1000 + 44 * -(-head.count // _CHUNK_ROWS) + len(json.dumps(head.ours)))
    entries: list[dict[str, Any]] = []
    with path.open("wb") as file:
        file.seek(8 + header_bytes)
        for chunk in encoder.chunks(parts):
            entries.append({"offset": encoder.num_bytes - len(chunk), "bytes": len(chunk)})
            file.write(chunk)
        text = encoder.header(entries)
        assert len(text) <= header_bytes
        file.seek(0)
        file.write(MAGIC + header_bytes.to_bytes(4, "little") + text.ljust(header_bytes))
    count = encoder.num_clamped
    return (f"colours or harmonics beyond ±{HALF_MAX:g}: clamped in {gaussians_in_words(count)}",) if count else ()


class _Encoder:
    """Encodes the chunks of a file, and the header that speaks of all of them."""

    def __init__(self, head: _Head, options: WriteOptions, name: str) -> None:
        level = 2 if options.compression is None else options.compression
        if level not in (0, 1, 2):
            raise InputError(f"{name}: found compression {level}, wanted 0 (floats), 1 (half precision) or 2 (8 bits)")
        self._head, self._level, self._name = head, level, name
        self._sample = [Gaussians.empty(head.sh_degree)]
        self.num_bytes = 0
        """Bytes of the chunks so far."""
        self.num_clamped = 0
        """Gaussians so far with values that half precision does not hold."""

    def chunks(self, parts: Iterator[Gaussians]) -> Iterator[bytes]:
        """Each part as a chunk."""
        from concurrent.futures import ThreadPoolExecutor

        nodes, begin = self._head.nodes, 0
        every = max(1, self._head.count // _SAMPLE)
        with (
            task(f"write {self._name}", self._head.count) as advance,
            ThreadPoolExecutor(_core.hardware_threads()) as pool,
        ):
            for part in parts:
                links = None if nodes is None else nodes.links(begin, begin + len(part))
                chunk = _encode_chunk(part, links, self._level, begin, pool)
                self._sample.append(part.take(np.arange(-begin % every, len(part), every)))
                self.num_bytes += len(chunk)
                self.num_clamped += _num_beyond_half(part, self._level)
                begin += len(part)
                yield chunk
                advance(len(part))

    def header(self, entries: list[dict[str, Any]]) -> bytes:
        """The header of a file whose chunks are at these places."""
        head, has_levels = self._head, self._head.nodes is not None
        meta: dict[str, Any] = {"version": 1, "type": "gsplat", "count": head.count, "maxSh": head.sh_degree}
        meta |= {"lodTree": True} if has_levels else {}
        meta |= {"chunkSize": _CHUNK_ROWS, "allChunkBytes": self.num_bytes, "chunks": entries}
        ranges = _display_ranges(Gaussians.concatenate(self._sample), has_levels)
        meta |= {"splatEncoding": ranges, "comment": "written by splatree", "splatree": head.ours}
        return json.dumps(meta, separators=(",", ":")).encode()


def _encode_chunk(part: Gaussians, links: Links | None, level: int, begin: int, pool: "ThreadPoolExecutor") -> bytes:
    properties = list(_encoded(part, level))
    if links is not None:
        properties.append(({"property": "child_count", "encoding": "u16"}, links.num_children.tobytes()))
        properties.append(({"property": "child_start", "encoding": "u32"}, links.first_child.tobytes()))
    num_public = len(properties)
    if links is not None and links.extents is not None:
        properties.append(({"property": "extent", "encoding": "f32"}, encode_floats(links.extents[:, None], "f32")))
    payload = bytearray()
    for (entry, _), packed in zip(properties, pool.map(_deflated, properties), strict=True):
        entry |= {"offset": len(payload), "bytes": len(packed), "compression": "gz"}
        payload += packed.ljust(padded(len(packed)), b"\0")
    meta: dict[str, Any] = {
        "version": 1,
        "base": begin,
        "count": len(part),
        "payloadBytes": len(payload),
        "maxSh": part.sh_degree,
    }
    meta |= {"lodTree": True} if links is not None else {}
    entries = [entry for entry, _ in properties]
    meta |= {"properties": entries[:num_public]}
    # Other readers refuse a property whose name they do not know, and pass over a key of the header.
    meta |= {"splatree": {"properties": entries[num_public:]}} if entries[num_public:] else {}
    text = json.dumps(meta, separators=(",", ":")).encode()
    header = CHUNK_MAGIC + len(text).to_bytes(4, "little") + text.ljust(padded(len(text)), b"\0")
    return header + len(payload).to_bytes(8, "little") + bytes(payload)


def _deflated(named: tuple[dict[str, Any], bytes]) -> bytes:
    entry, data = named
    level, strategy = _DEFLATE.get(entry["property"], _DEFLATE_OTHERS)
    deflate = zlib.compressobj(level, zlib.DEFLATED, -zlib.MAX_WBITS, zlib.DEF_MEM_LEVEL, strategy)
    return deflate.compress(data) + deflate.flush()


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
        codes = b"".join(encode_rotations(g.quats[i : i + _ROWS_AT_ONCE]) for i in range(0, len(g), _ROWS_AT_ONCE))
        yield {"property": "orientation", "encoding": "oct88r8"}, codes
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
            planes = np.empty(values.T.shape, np.int8)
            for first in range(0, len(g), _ROWS_AT_ONCE):
                rows = slice(first, first + _ROWS_AT_ONCE)
                planes[:, rows] = np.rint(values[rows] * np.float32(127 / high)).T
            yield entry, planes.tobytes()
        else:
            yield {"property": name, "encoding": wide}, encode_floats(values, wide)


def _num_beyond_half(g: Gaussians, level: int) -> int:
    """How many Gaussians have a colour, or at level 1 a harmonic, that half precision does not hold."""
    if level == 0:
        return 0
    beyond = (np.abs(np.float32(0.5) + np.float32(SH_C0) * g.sh[:, 0]) > HALF_MAX).any(axis=1)
    if level == 1:
        beyond |= (np.abs(g.sh[:, 1:]) > HALF_MAX).any(axis=(1, 2))
    return int(beyond.sum())


def _range(values: Array) -> tuple[float, float]:
    """Least and largest value, apart from each other."""
    low, high = float(values.min()), float(values.max())
    return (low, high) if high > low else (low, float(np.nextafter(np.float32(low), np.float32(np.inf))) + 1e-3)


def _display_ranges(g: Gaussians, has_levels: bool) -> dict[str, Any]:
    """Ranges to which a viewer that keeps 8 bits in memory should spread values: the middle 98 % of a sample, as Spark's."""

    def middle(values: Array) -> tuple[float, float]:
        low, high = np.quantile(values, (0.01, 0.99)) if values.size else (0, 0)
        return float(low), float(high)

    rgb = middle(0.5 + SH_C0 * g.sh[:, 0])
    log_scales = middle(g.log_scales)
    ranges: dict[str, Any] = {"rgbMin": min(0.0, rgb[0]), "rgbMax": max(1.0, rgb[1])}
    ranges |= {"lnScaleMin": min(-12.0, log_scales[0]), "lnScaleMax": max(9.0, log_scales[1])}
    for order in range(1, 4):
        rest = middle(g.sh[:, order * order : (order + 1) ** 2])
        ranges[f"sh{order}Max"] = max(1.0, -rest[0], rest[1])
    return ranges | {"lodOpacity": has_levels}
