"""A small writer of .rad files, for tests alone: it puts any bytes under any name."""

import json
import zlib
from pathlib import Path


def padded(data: bytes, fill: bytes = b"\0") -> bytes:
    return data + fill * (-len(data) % 8)


def deflated(data: bytes) -> bytes:
    packer = zlib.compressobj(9, zlib.DEFLATED, -15)
    return packer.compress(data) + packer.flush()


def chunk(properties: list[tuple[dict, bytes]], *, count: int, base: int = 0, compress: bool = True, **extra) -> bytes:
    """A chunk of (entry, raw bytes); entries may say another offset or size than is true."""
    payload, entries = b"", []
    for entry, raw in properties:
        data = deflated(raw) if compress else raw
        kind = {"compression": "gz"} if compress else {}
        entries.append({"offset": len(payload), "bytes": len(data), **kind, **entry})
        payload += padded(data)
    header = {"version": 1, "base": base, "count": count, "payloadBytes": len(payload), "properties": entries, **extra}
    text = json.dumps(header).encode()
    return b"RADC" + len(text).to_bytes(4, "little") + padded(text) + len(payload).to_bytes(8, "little") + payload


def write_rad(path: Path, parts: list[bytes], *, count: int, **extra) -> Path:
    """A file of chunks; ``extra`` are further keys of its header, or other values of those it has."""
    entries, offset = [], 0
    for data in parts:
        entries.append({"offset": offset, "bytes": len(data)})
        offset += len(data)
    header = {"version": 1, "type": "gsplat", "count": count, "chunks": entries, "allChunkBytes": offset, **extra}
    text = json.dumps(header).encode()
    path.write_bytes(b"RAD0" + len(text).to_bytes(4, "little") + padded(text) + b"".join(parts))
    return path
