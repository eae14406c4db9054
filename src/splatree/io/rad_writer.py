"""Write ``.rad``: nodes breadth-first in chunks of 65,536, each encoded and deflated on a processor of its own.

The header stands before the chunks but lists their places; it is written last, into the room kept for it, padded with spaces.
Ranges of 8-bit codes are those of each chunk: nothing is clipped, and a chunk of small Gaussians has small steps.
"""

import json
import zlib
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from splatree.constants import SH_C0
from splatree.errors import InputError
from splatree.io.check import checked
from splatree.io.opacities import opacities_from_logits
from splatree.io.options import WriteOptions
from splatree.io.rad_container import CHUNK_MAGIC, MAGIC, padded
from splatree.io.rad_properties import LOG_SCALE_ZERO, encode_codes, encode_floats, encode_rotations
from splatree.kernels.cpu import _core
from splatree.kernels.cpu.merge import merge
from splatree.maths.forests import Links, links_from_preorder
from splatree.progress import task
from splatree.scene.gaussians import Gaussians
from splatree.scene.scene import Scene
from splatree.scene.thinning import Groups, MergeOptions
from splatree.shapes import Array

_CHUNK_ROWS = 1 << 16
_DEFLATE_LEVEL = 6
_RGB_RANGE_MAX = 2.0
"""A chunk whose colours span more is written in half precision instead of 255 steps."""

_LOG_SCALE_RANGE_MAX = 25.0
"""The same of log-scales: 254 steps of a tenth."""


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
    header_bytes = padded(1000 + 44 * len(starts))
    entries: list[dict[str, int]] = []
    from concurrent.futures import ThreadPoolExecutor

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
        meta |= {"splatree": {"mode": scene.mode, "threshold": scene.threshold, "joinsRoots": joins_roots}}
        text = json.dumps(meta, separators=(",", ":")).encode()
        assert len(text) <= header_bytes
        file.seek(0)
        file.write(MAGIC + header_bytes.to_bytes(4, "little") + text.ljust(header_bytes))
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
        payload += packed.ljust(padded(len(packed)), b"\0")
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
    header = CHUNK_MAGIC + len(text).to_bytes(4, "little") + text.ljust(padded(len(text)), b"\0")
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
