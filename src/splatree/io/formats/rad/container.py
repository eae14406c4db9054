"""The container of ``.rad`` files: headers of the file and of its chunks, checked, and the bytes of a property.

Everything that a header says is held against the size of the file before anything is allocated; a property is inflated to the
size that its encoding has and no further.
"""

import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, cast

from splatree.constants import ALPHA_THRESHOLD
from splatree.errors import FormatError, InputError
from splatree.io import untrusted
from splatree.io.formats.rad.properties import check_encoding, decode, raw_bytes
from splatree.scene.levels import LevelRecord, record_from_fields
from splatree.scene.names import Mode
from splatree.shapes import Array

__all__ = ["CHUNK_MAGIC", "MAGIC", "RadChunk", "RadFile", "open_rad", "padded", "values_of"]

MAGIC, CHUNK_MAGIC = b"RAD0", b"RADC"
_JSON_MAX = 1 << 24
"""A longer header is refused: a chunk of 65,536 takes 40 bytes of it."""

_ROWS_ALWAYS = 1 << 16
_ROWS_PER_BYTE = 0.25
"""More Gaussians than this for a byte of the file (real ones hold one in 15 to 60) are a decompression bomb, unless they are
few: a Gaussian of degree 3 takes 236 bytes in memory."""


@dataclass(frozen=True, eq=False)
class RadChunk:
    """A chunk's header, checked."""

    path: Path
    num_bytes: int
    payload: int  # byte of the file
    base: int
    count: int
    properties: dict[str, dict[str, Any]]
    where: str


@dataclass(frozen=True, eq=False)
class RadFile:
    """The file's header and those of its chunks, checked."""

    where: str
    count: int
    degree: int
    has_levels: bool
    has_lod_opacities: bool
    chunks: list[RadChunk]
    num_codes: int
    mode: Mode
    threshold: float
    joins_roots: bool
    record: LevelRecord | None
    comment: str


def open_rad(path: Path) -> RadFile:
    """Read and check all headers."""
    where = str(path)
    num_bytes = path.stat().st_size
    with path.open("rb") as file:
        meta, chunks_at = _read_header(file, num_bytes, MAGIC, where)
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
        threshold = untrusted.number({"threshold": ALPHA_THRESHOLD, **ours}, "threshold", f"{where}: splatree")
        if not 0 < threshold < 1:
            raise FormatError(f"{where}: splatree.threshold: found {threshold}, wanted between 0 and 1")
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
    return RadFile(
        where=where,
        count=count,
        degree=degree,
        has_levels=has_levels,
        has_lod_opacities=has_levels or encoding.get("lodOpacity") is True,
        chunks=chunks,
        num_codes=num_codes,
        mode=cast(Mode, mode),
        threshold=threshold,
        record=_record(ours, f"{where}: splatree.levels") if has_levels else None,
        joins_roots=has_levels and count > 0 and ours.get("joinsRoots") is True,
        comment=str(meta.get("comment") or "")[:1000],
    )


def _record(ours: dict[str, Any], where: str) -> LevelRecord | None:
    """How the levels were made, if splatree wrote the file; None: another program did, or an older splatree."""
    if "levels" not in ours:
        return None
    try:
        return record_from_fields(ours["levels"])
    except InputError as error:
        raise FormatError(f"{where}: {error}") from error


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
    return meta, start + 8 + padded(length)


def _open_chunk(path: Path, file: BinaryIO, chunks_at: int, entry: Any, where: str) -> RadChunk:
    entry = untrusted.as_object(entry, where)
    offset, size = (untrusted.integer(entry, key, where, high=2**62) for key in ("offset", "bytes"))
    if entry.get("filename") is None:
        return _parse_chunk(path, file, chunks_at + offset, size, where)
    beside = untrusted.inner_file(path.parent, untrusted.text(entry, "filename", where), where)
    with beside.open("rb") as other:
        return _parse_chunk(beside, other, offset, size, where)


def _parse_chunk(path: Path, file: BinaryIO, start: int, size: int, where: str) -> RadChunk:
    num_bytes = path.stat().st_size
    if start + size > num_bytes:
        raise FormatError(
            f"{where}: found bytes {start} to {start + size} in a file of {num_bytes}; it is cut off or damaged"
        )
    file.seek(start)
    meta, behind = _read_header(file, start + size, CHUNK_MAGIC, where)
    if meta.get("version") != 1:
        raise FormatError(f"{where}: found version {str(meta.get('version'))[:40]}, wanted 1")
    base, count = (untrusted.integer(meta, key, where) for key in ("base", "count"))
    payload_bytes = start + size - behind - 8
    properties: dict[str, dict[str, Any]] = {}
    entries = untrusted.as_list(untrusted.field(meta, "properties", where), where)
    ours = untrusted.as_object(meta.get("splatree") or {}, f"{where}: splatree")
    for entry in (*entries, *untrusted.as_list(ours.get("properties") or [], f"{where}: splatree.properties")):
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
    return RadChunk(path, size, behind + 8, base, count, properties, where)


def values_of(chunk: RadChunk, name: str, num_rows: int | None = None) -> Array:
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


def padded(num_bytes: int) -> int:
    """Bytes with their padding to a multiple of 8."""
    return -(-num_bytes // 8) * 8
