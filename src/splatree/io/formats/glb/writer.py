"""Writing ``.glb``: plain attributes (KHR_gaussian_splatting), or an SPZ in their place; `glb/reader.py` describes both.

Every attribute is a plane of its own, whose place follows from the number of rows: each chunk's part of each plane is written
where it belongs, and the JSON, which holds the bounds of the means, into the room that was left for it. Memory is a chunk.
"""

import json
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from splatree.constants import SH_C0
from splatree.errors import InputError
from splatree.io.check import refuse_unusable
from splatree.io.chunks import Chunks
from splatree.io.formats.glb.container import GLB_BYTES_MAX, MAGIC
from splatree.io.formats.glb.names import EXTENSION, SPZ_EXTENSION
from splatree.io.formats.glb.reader import GLTF_AXES, SPZ_AXES, SPZ_AXES_KEY
from splatree.io.formats.spz import format as spz
from splatree.io.options import WriteOptions
from splatree.kernels.cpu.runtime.files import write_at
from splatree.maths.axes import harmonic_signs, quat_signs, signs_between
from splatree.progress import task
from splatree.scene.gaussians import Gaussians
from splatree.scene.origin import NO_ORIGIN
from splatree.shapes import Array

_SPZ_VERSION = 2
"""Version of SPZ to which the extension is pinned."""

_SIGNS = signs_between(spz.SCENE_AXES, GLTF_AXES)
_FLOAT, _BYTE = 5126, 5121
_JSON, _BIN = 0x4E4F534A, 0x004E4942
_NUMBER = -1.2345678901234567e-300
"""A bound of a mean takes no more room in the JSON than this."""


@dataclass(frozen=True)
class _Attribute:
    name: str
    shape: str  # SCALAR, VEC3 …
    width: int
    is_bytes: bool = False

    @property
    def row_bytes(self) -> int:
        return self.width * (1 if self.is_bytes else 4)


def write_chunks(chunks: Chunks, path: Path, options: WriteOptions) -> tuple[str, ...]:
    """Write a .glb, plain or with ``options.packing`` = spz."""
    with path.open("wb") as file:
        if options.packing == "spz":
            return _write_spz(chunks, file, path, options, SPZ_AXES)
        for name in ("format_version", "sh_bits", "compression"):
            if getattr(options, name) is not None:
                raise InputError(f"{path}: found the option {name}, which is for a .glb with packing spz only")
        return _write_plain(chunks, file, path)


def write_tile(chunks: Chunks, path: Path) -> tuple[str, ...]:
    """Write a .glb with an SPZ whose numbers are in the axes of glTF, as CesiumJS takes them; `SPZ_AXES_KEY` says so.

    The extension's draft stores them in other axes, which CesiumJS does not turn back.
    """
    with path.open("wb") as file:
        return _write_spz(chunks, file, path, WriteOptions(), GLTF_AXES)


def _attributes(degree: int) -> list[_Attribute]:
    harmonics = [(d, i) for d in range(degree + 1) for i in range(2 * d + 1)]
    return [
        _Attribute("POSITION", "VEC3", 3),
        _Attribute("COLOR_0", "VEC4", 4, is_bytes=True),
        _Attribute(f"{EXTENSION}:ROTATION", "VEC4", 4),
        _Attribute(f"{EXTENSION}:SCALE", "VEC3", 3),
        _Attribute(f"{EXTENSION}:OPACITY", "SCALAR", 1),
        *(_Attribute(f"{EXTENSION}:SH_DEGREE_{d}_COEF_{i}", "VEC3", 3) for d, i in harmonics),
    ]


def _write_plain(chunks: Chunks, file: BinaryIO, path: Path) -> tuple[str, ...]:
    n, attributes = len(chunks), _attributes(chunks.sh_degree)
    starts = np.concatenate([[0], np.cumsum([a.row_bytes * n for a in attributes])]).tolist()
    views = [
        {"buffer": 0, "byteOffset": s, "byteLength": a.row_bytes * n} for a, s in zip(attributes, starts, strict=False)
    ]
    bounds = np.full((2, 3), _NUMBER)
    room = len(_json(chunks, attributes, bounds, views, starts[-1]))
    room += -room % 4
    at = 12 + 8 + room + 8
    if at + starts[-1] > GLB_BYTES_MAX:
        raise InputError(
            f"{path}: found {n:,} Gaussians, {at + starts[-1]:,} bytes as a .glb, wanted less than 4 GiB; cut off harmonics, or "
            "pack them with packing spz"
        )
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    begin = 0
    with task(f"write {path.name}", n) as advance:
        for g in chunks:
            refuse_unusable(g, "scene to write", first_row=begin)
            for attribute, start, values in zip(attributes, starts, _columns(g), strict=False):
                write_at(file, at + start + begin * attribute.row_bytes, values)
            means = g.means * _SIGNS
            low, high = np.minimum(low, means.min(axis=0)), np.maximum(high, means.max(axis=0))
            begin += len(g)
            advance(len(g))
    bounds = np.stack([low, high]) if n else np.zeros((2, 3))
    text = _json(chunks, attributes, bounds, views, starts[-1]).ljust(room)
    write_at(file, 0, _head(text, starts[-1]))
    return ()


def _write_spz(chunks: Chunks, file: BinaryIO, path: Path, options: WriteOptions, spz_axes: str) -> tuple[str, ...]:
    attributes = _attributes(chunks.sh_degree)
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for g in chunks:
        means = g.means * _SIGNS
        low, high = np.minimum(low, means.min(axis=0)), np.maximum(high, means.max(axis=0))
    bounds = np.stack([low, high]) if len(chunks) else np.zeros((2, 3))
    views = [{"buffer": 0, "byteLength": GLB_BYTES_MAX}]
    room = len(_json(chunks, attributes, bounds, views, GLB_BYTES_MAX, spz_axes=spz_axes))
    room += -room % 4
    start = 12 + 8 + room + 8
    file.seek(start)
    version = _SPZ_VERSION if options.format_version is None else options.format_version
    lost = spz.encode(chunks, file, path, version=version, axes=None, options=options, unnamed_axes=spz_axes)
    size = file.tell() - start
    padded = size + -size % 4
    if start + padded > GLB_BYTES_MAX:
        raise InputError(f"{path}: found {start + padded:,} bytes, wanted less than 4 GiB in a .glb; write an .spz")
    file.write(bytes(padded - size))
    views = [{"buffer": 0, "byteLength": size}]
    text = _json(chunks, attributes, bounds, views, padded, spz_axes=spz_axes).ljust(room)
    file.seek(0)
    file.write(_head(text, padded))
    return lost


def _head(text: bytes, num_bytes: int) -> bytes:
    """All of the file before its binary data."""
    length = 12 + 8 + len(text) + 8 + num_bytes
    return MAGIC + struct.pack("<IIII", 2, length, len(text), _JSON) + text + struct.pack("<II", num_bytes, _BIN)


def _json(
    chunks: Chunks,
    attributes: list[_Attribute],
    bounds: Array,
    views: list[dict[str, Any]],
    num_bytes: int,
    *,
    spz_axes: str | None = None,
) -> bytes:
    """The JSON of a file; attributes that are packed, in an SPZ in these axes, have accessors without a view."""
    packed = spz_axes is not None
    accessors: list[dict[str, Any]] = []
    for index, a in enumerate(attributes):
        accessor: dict[str, Any] = {} if packed else {"bufferView": index}
        accessor |= {"componentType": _BYTE if a.is_bytes else _FLOAT, "count": len(chunks), "type": a.shape}
        if a.is_bytes:
            accessor["normalized"] = True
        if a.name == "POSITION":
            accessor |= {"min": bounds[0].tolist(), "max": bounds[1].tolist()}
        accessors.append(accessor)
    extension: dict[str, Any] = {
        "kernel": "ellipse",
        "colorSpace": "srgb_rec709_display",
        "sortingMethod": "cameraDistance",
        "projection": "perspective",
    }
    if packed:
        extension["extensions"] = {SPZ_EXTENSION: {"bufferView": 0}}
    primitive: dict[str, Any] = {
        "attributes": {a.name: index for index, a in enumerate(attributes)},
        "mode": 0,
        "extensions": {EXTENSION: extension},
    }
    if chunks.mode == "antialiased":
        primitive["extras"] = {"SplatRenderMode": "mip"}
    node: dict[str, Any] = {"mesh": 0}
    if chunks.origin != NO_ORIGIN:
        node["translation"] = (np.asarray(chunks.origin) * _SIGNS).tolist()
    used = [EXTENSION, SPZ_EXTENSION] if packed else [EXTENSION]
    extras = {"extras": {SPZ_AXES_KEY: spz_axes}} if packed and spz_axes != SPZ_AXES else {}
    content = {
        "asset": {"version": "2.0", "generator": "splatree", **extras},
        "extensionsUsed": used,
        **({"extensionsRequired": used} if packed else {}),  # the attributes alone would be zeros
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [node],
        "meshes": [{"primitives": [primitive]}],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": num_bytes}],
    }
    return json.dumps(content, separators=(",", ":")).encode()


def _columns(g: Gaussians) -> Iterator[Array]:
    """The part of each attribute, in their order."""
    opacities = g.opacities()
    colors = np.empty((len(g), 4), np.uint8)
    colors[:, :3] = np.rint(np.clip(0.5 + SH_C0 * g.sh[:, 0], 0, 1) * 255)
    colors[:, 3] = np.rint(opacities * 255)
    quats = g.quats / np.linalg.norm(g.quats.astype(np.float64), axis=1, keepdims=True) * quat_signs(_SIGNS)
    yield g.means * _SIGNS
    yield colors
    yield np.roll(quats, -1, axis=1).astype(np.float32)
    yield np.exp(g.log_scales)
    yield opacities.astype(np.float32)
    for k, sign in enumerate(harmonic_signs(_SIGNS, g.sh_degree)):
        yield g.sh[:, k] * sign
