"""Native ``.splatree``: a safetensors file with one tensor a column of the scene and its other fields as JSON strings.

The file is an eight-byte length, a JSON header and the columns, each where the header says; so it is memory-mapped and no
byte is copied: a scene opens in the time of checking its values. Which columns there are follows from the fields of `Scene`
and of the structs in it: ``gaussians.means``, ``tree.depth``, ``ids`` and so on; a field that holds None is left out. The block
index is not kept: one from a stale or hostile file could hide rows without a trace, and making it anew costs 25 ns a row. For the
same reason the radii and boxes of clusters are written for others to read, but computed anew here, in 10 ns a row.

Any safetensors library reads the file, and no code is ever loaded from it. That library is not used here, because it copies
every tensor and builds the whole file in memory before it writes; in the tests it is the judge.
docs/reference/formats/splatree.md.
"""

import json
import math
import mmap
import types
from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Union, get_args, get_origin, get_type_hints

import numpy as np

from splatree.errors import FormatError, InputError
from splatree.io import untrusted
from splatree.io.check import checked
from splatree.io.formats.splatree.older import record_of_provenance
from splatree.io.levels import check_extents
from splatree.io.options import ReadOptions, WriteOptions
from splatree.kernels.cpu.build.spheres import bound_clusters
from splatree.kernels.cpu.frame.blocks import index_blocks
from splatree.progress import task
from splatree.scene.levels import LevelRecord
from splatree.scene.scene import Scene, Source
from splatree.shapes import Array

VERSION = 1
"""Version written, and the newest that is read; a new field of a scene does not change it, a new meaning does."""

_HEADER_MAX = 100_000_000
"""Bytes; the limit of the safetensors library."""

_ALIGNMENT = 64
"""The first column starts at a multiple of this, so that mapped columns are aligned as kernels like them."""

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


NOT_STORED = ("blocks", "device")
"""Fields of a scene that are of this run: an index that is made anew, and where it is drawn."""

STORED_AS = {"tile_rule": "extent"}
"""Fields whose name in the file is an older one, which stays so that files of every version are read by every version."""


def sniff(path: Path, head: bytes) -> bool:
    """Whether the file is a safetensors file that says it is ours in its metadata, which we write first."""
    return head[8:].startswith(b'{"__metadata__":{"format":"splatree"')


def write(scene: Scene, path: Path, options: WriteOptions) -> tuple[str, ...]:
    """Write every column and field; reading gives the same bits."""
    kept = replace(scene, blocks=None)
    columns, values = dict(_columns(kept, "")), dict(_values(kept, ""))
    for name in NOT_STORED:
        values.pop(name, None)
    # Wide types first: then each column is aligned, as its predecessors' sizes are multiples of its own width.
    columns = dict(sorted(columns.items(), key=lambda item: -item[1].itemsize))
    header: dict[str, Any] = {"__metadata__": {"format": "splatree", "version": str(VERSION), **values}}
    offset = 0
    for name, column in columns.items():
        end = offset + column.nbytes
        header[name] = {"dtype": _NAMES[column.dtype.name], "shape": column.shape, "data_offsets": [offset, end]}
        offset = end
    text = json.dumps(header, separators=(",", ":")).encode()
    text += b" " * (-(8 + len(text)) % _ALIGNMENT)
    with path.open("wb") as file, task(f"write {path.name}", offset) as advance:
        file.write(len(text).to_bytes(8, "little") + text)
        for column in columns.values():
            if column.nbytes:
                file.write(np.ascontiguousarray(column).reshape(-1).view(np.uint8).data)
            advance(column.nbytes)
    return ()


def read(path: Path, options: ReadOptions) -> Scene:
    """Map the columns into memory; they are read-only."""
    where = str(path)
    with path.open("rb") as file:
        num_bytes = path.stat().st_size
        header_bytes = int.from_bytes(file.read(8), "little")
        if num_bytes < 8 or header_bytes > min(_HEADER_MAX, num_bytes - 8):
            raise FormatError(
                f"{where}: found a header of {header_bytes} bytes in a file of {num_bytes}; the file is cut off or no .splatree"
            )
        header = untrusted.as_object(untrusted.parse_json(file.read(header_bytes), where), where)
        mapped = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
    values = untrusted.as_object(header.pop("__metadata__", None), f"{where}: __metadata__")
    version = values.get("version")
    if values.get("format") != "splatree" or version != str(VERSION):
        raise FormatError(
            f"{where}: found format {values.get('format')!r}, version {version!r}, wanted 'splatree', '{VERSION}'; "
            "a newer file needs a newer splatree, other safetensors are no scene"
        )
    start = 8 + header_bytes
    columns = {name: _column(mapped, entry, start, f"{where}: {name}") for name, entry in header.items()}
    total = sum(column.nbytes for column in columns.values())
    if total != num_bytes - start:
        raise FormatError(
            f"{where}: found {num_bytes - start} bytes behind the header, wanted {total} for its columns; the file is cut off "
            "or damaged"
        )
    columns = {name: column if column.flags.aligned else column.copy() for name, column in columns.items()}
    known = set(columns)
    _add_boxes(columns)
    try:
        scene = _build(Scene, "", columns, values, where)
    except InputError as error:
        if isinstance(error, FormatError):
            raise
        raise FormatError(f"{where}: {error}") from error
    if columns:
        raise FormatError(f"{where}: found unknown columns {sorted(columns)} beside {sorted(known - set(columns))}")
    if scene.tree.record is None and scene.tree.depth.any():
        record = record_of_provenance(scene.source.metadata.get("levels"))
        scene = replace(scene, tree=replace(scene.tree, record=record))
    check_extents(scene.tree.extents, where)
    scene = checked(scene, where, repair=options.repair)
    clusters = scene.clusters
    if clusters is None and scene.tree.num_leaves == len(scene):
        return scene
    if clusters is not None:
        clusters = bound_clusters(scene.gaussians, clusters.start, clusters.centers)
    return replace(scene, blocks=index_blocks(scene.gaussians, scene.tree), clusters=clusters)


def _add_boxes(columns: dict[str, Array]) -> None:
    """Boxes of clusters that hold everything, where a file is older than they are; they are computed anew anyway."""
    centers = columns.get("clusters.centers")
    if centers is not None:
        for name, bound in (("box_low", -np.inf), ("box_high", np.inf)):
            columns.setdefault(f"clusters.{name}", np.full(centers.shape, bound, np.float32))


def _columns(struct: Any, prefix: str) -> Iterator[tuple[str, Array]]:
    """Each array of a struct and of the structs in it, by its dotted name."""
    for f in fields(struct):
        value = getattr(struct, f.name)
        if isinstance(value, np.ndarray):
            yield prefix + f.name, value
        elif is_dataclass(value) and not isinstance(value, Source | LevelRecord):
            yield from _columns(value, f"{prefix}{f.name}.")


def _values(struct: Any, prefix: str) -> Iterator[tuple[str, str]]:
    """Each field that is neither an array nor a struct, by its dotted name, as JSON."""
    for f in fields(struct):
        value = getattr(struct, f.name)
        if isinstance(value, Source):
            metadata = dict(value.metadata)
            if (
                value.format and value.format != "splatree"
            ):  # where the first file came from, without this machine's folders
                metadata["origin"] = json.dumps({"format": value.format, "names": [Path(p).name for p in value.paths]})
            yield prefix + f.name, json.dumps(metadata)
        elif isinstance(value, LevelRecord):
            yield prefix + f.name, value.to_json()
        elif is_dataclass(value):
            yield from _values(value, f"{prefix}{f.name}.")
        elif value is not None and not isinstance(value, np.ndarray):
            yield prefix + STORED_AS.get(f.name, f.name), json.dumps(value)


def _build(kind: type, prefix: str, columns: dict[str, Array], values: Mapping[str, Any], where: str) -> Any:
    """A struct from the columns and values under a prefix; takes what it uses out of ``columns``."""
    arguments: dict[str, Any] = {}
    for name, hint in get_type_hints(kind, include_extras=True).items():
        key = prefix + STORED_AS.get(name, name)
        if key in NOT_STORED:
            continue
        inner, optional = _unwrap(hint)
        if inner is Source:
            metadata = untrusted.as_object(_value(values, key, where), f"{where}: {key}")
            arguments[name] = Source(
                metadata={k: untrusted.as_text(v, f"{where}: {key}.{k}") for k, v in metadata.items()}
            )
        elif inner is LevelRecord:
            text = values.get(key)
            arguments[name] = (
                None if text is None else LevelRecord.from_json(untrusted.as_text(text, f"{where}: {key}"))
            )
        elif isinstance(inner, type) and is_dataclass(inner):
            held = any(k.startswith(f"{key}.") for k in columns)
            arguments[name] = _build(inner, f"{key}.", columns, values, where) if held or not optional else None
        elif get_origin(inner) is Annotated:
            if key not in columns and not optional:
                raise FormatError(
                    f"{where}: found no column {key!r}; the file is damaged or was made by another version"
                )
            arguments[name] = columns.pop(key, None)
        else:
            arguments[name] = None if optional and key not in values else _value(values, key, where)
    try:
        return kind(**arguments)
    except TypeError as error:  # a number where a string is wanted, or the like
        raise FormatError(f"{where}: {prefix or 'scene'}: {error}") from error


def _unwrap(hint: Any) -> tuple[Any, bool]:
    """The type without "| None", and whether None was allowed."""
    if get_origin(hint) in (Union, types.UnionType):
        inner = [a for a in get_args(hint) if a is not type(None)]
        return inner[0], len(inner) < len(get_args(hint))
    return hint, False


def _value(values: Mapping[str, Any], key: str, where: str) -> Any:
    text = untrusted.text(values, key, f"{where}: __metadata__")
    return untrusted.parse_json(text.encode(), f"{where}: __metadata__.{key}")


def _column(mapped: mmap.mmap, entry: Any, start: int, where: str) -> Array:
    """A view of the mapped file."""
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
    if len(shape) > 8 or len(offsets) != 2 or offsets[1] - offsets[0] != size or start + offsets[1] > len(mapped):
        raise FormatError(
            f"{where}: found bytes {offsets} for shape {shape} of {dtype.name} ({size} bytes) in a file that holds "
            f"{len(mapped) - start} bytes of columns; the file is cut off or damaged"
        )
    return np.ndarray(shape, dtype, mapped, start + offsets[0]) if size else np.empty(shape, dtype)
