"""The frame of glTF 2.0: a ``.glb`` (JSON and one binary chunk) or a ``.gltf`` with buffers beside or inside it, and accessors.

A ``.glb`` is ``glTF``, version 2 and length (u4), then chunks: length (u4), ``JSON`` or ``BIN``, bytes up to a multiple of four.
An accessor is rows of one to four numbers in a range of a buffer. Nothing is read before its place was held against the size of
its file; a buffer's file must lie in the folder of the ``.gltf``. Khronos, glTF 2.0 specification, §3.6 and §4.4.
"""

import base64
import binascii
import io
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from splatree.errors import FormatError
from splatree.io import untrusted
from splatree.io.formats.glb.names import packed_hint
from splatree.shapes import Array

MAGIC = b"glTF"
GLB_BYTES_MAX = (1 << 32) - 1
"""Lengths in a .glb are u4."""

_COMPONENTS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}


@dataclass(frozen=True)
class _Buffer:
    file: BinaryIO
    start: int
    num_bytes: int


@dataclass(frozen=True)
class Accessor:
    """Rows of numbers in a buffer."""

    file: BinaryIO
    """Where they are."""
    start: int
    """Byte of the first row."""
    stride: int
    """Bytes from row to row."""
    count: int
    """Rows."""
    dtype: np.dtype[Any]
    """Of a number."""
    width: int
    """Numbers of a row."""
    is_normalized: bool
    """Whether whole numbers stand for −1 to 1 or 0 to 1."""
    where: str
    """Its name in errors."""

    def rows(self, begin: int, end: int) -> Array:
        """Rows as float32 "n w"."""
        count, row_bytes = end - begin, self.dtype.itemsize * self.width
        num_bytes = (count - 1) * self.stride + row_bytes if count else 0
        data = np.empty(num_bytes, np.uint8)
        self.file.seek(self.start + begin * self.stride)
        if _readinto(self.file, data.data) < num_bytes:
            raise FormatError(f"{self.where}: cannot be read to its end; did the file change meanwhile?")
        shape, strides = (count, self.width), (self.stride, self.dtype.itemsize)
        values = np.ndarray(shape, self.dtype, data, 0, strides)
        if not self.is_normalized:
            return np.asarray(values, np.float32)
        largest = np.float32(np.iinfo(self.dtype).max)
        return np.asarray(np.maximum(values.astype(np.float32) / largest, np.float32(-1)))


class Window(io.RawIOBase):
    """Some bytes of an open file as a file of their own, which leaves that one open."""

    def __init__(self, file: BinaryIO, start: int, num_bytes: int) -> None:
        super().__init__()
        self._file, self._start, self._num_bytes, self._at = file, start, num_bytes, 0

    def readable(self) -> bool:
        """Always."""
        return True

    def seekable(self) -> bool:
        """Always."""
        return True

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        """Go to a byte of the window."""
        base = {io.SEEK_SET: 0, io.SEEK_CUR: self._at, io.SEEK_END: self._num_bytes}[whence]
        self._at = max(0, base + offset)
        return self._at

    def readinto(self, buffer: Any) -> int:
        """Read what has room in the buffer, or less."""
        view = memoryview(buffer).cast("B")[: max(0, self._num_bytes - self._at)]
        self._file.seek(self._start + self._at)
        count = _readinto(self._file, view)
        self._at += count
        return count


class GltfFile:
    """An open ``.glb`` or ``.gltf``: its JSON, and accessors into its buffers."""

    def __init__(self, path: Path, file: BinaryIO) -> None:
        self.where = str(path)
        self._path, self._file = path, file
        self._binary: _Buffer | None = None
        self._opened: dict[int, _Buffer] = {}
        self._files: list[BinaryIO] = []
        self.num_bytes = path.stat().st_size
        """Bytes of the file and of the buffers beside it that were opened, each once."""
        file.seek(0)
        text = self._glb_text() if file.read(4) == MAGIC else self._gltf_text()
        self.json = untrusted.as_object(untrusted.parse_json(text, self.where), self.where)
        version = untrusted.text(self._object(self.json, "asset"), "version", f"{self.where}: asset")
        if version.split(".")[0] != "2":
            raise FormatError(f"{self.where}: found glTF {version!r}, wanted 2.0")

    def close(self) -> None:
        """Close the files of the buffers; the file itself stays open."""
        for file in self._files:
            file.close()

    def files(self) -> list[Path]:
        """The files of the buffers that are not in the file itself."""
        buffers = untrusted.as_list(self.json.get("buffers", []), f"{self.where}: buffers")
        found = []
        for i in range(len(buffers)):
            name, record = f"{self.where}: buffers[{i}]", self.item("buffers", i, self.where)
            if "uri" in record and not (uri := untrusted.text(record, "uri", name)).startswith("data:"):
                found.append(self._beside(uri, name))
        return found

    def item(self, key: str, index: Any, where: str) -> dict[str, Any]:
        """The element ``index`` of the list ``key`` of the file."""
        items = untrusted.as_list(self.json.get(key, []), f"{self.where}: {key}")
        at = untrusted.as_integer(index, where, high=len(items) - 1) if items else None
        if at is None:
            raise FormatError(f"{where}: found index {index!r} into {key}, of which there are none")
        return untrusted.as_object(items[at], f"{self.where}: {key}[{at}]")

    def view(self, index: Any, where: str) -> tuple[BinaryIO, int, int, int]:
        """File, first byte, size and stride (0: none) of a buffer view."""
        record = self.item("bufferViews", index, where)
        name = f"{self.where}: bufferViews[{index}]"
        buffer = self._buffer(untrusted.integer(record, "buffer", name))
        start = untrusted.as_integer(record.get("byteOffset", 0), f"{name}.byteOffset", high=2**62)
        size = untrusted.integer(record, "byteLength", name, high=2**62)
        if start + size > buffer.num_bytes:
            raise FormatError(
                f"{name}: found bytes {start} to {start + size} of a buffer of {buffer.num_bytes}; the file is cut off or damaged"
            )
        stride = untrusted.as_integer(record.get("byteStride", 0), f"{name}.byteStride", high=252)
        return buffer.file, buffer.start + start, size, stride

    def accessor(self, index: Any, where: str) -> Accessor:
        """An accessor whose rows lie in its buffer view."""
        record = self.item("accessors", index, where)
        name = f"{self.where}: accessors[{index}]"
        kind = untrusted.integer(record, "componentType", name)
        shape = untrusted.text(record, "type", name)
        if kind not in _COMPONENTS or shape not in _WIDTHS:
            raise FormatError(f"{name}: found {shape} of component type {kind}, wanted a scalar or vector of numbers")
        if "sparse" in record or "bufferView" not in record:
            raise FormatError(
                f"{name}: found it sparse or without a bufferView, wanted plain rows{packed_hint(self.json)}"
            )
        dtype, width = np.dtype(_COMPONENTS[kind]), _WIDTHS[shape]
        file, start, size, stride = self.view(record["bufferView"], name)
        count = untrusted.integer(record, "count", name)
        offset = untrusted.as_integer(record.get("byteOffset", 0), f"{name}.byteOffset", high=2**62)
        row_bytes = width * dtype.itemsize
        stride = stride or row_bytes
        if stride < row_bytes or offset + (count - 1) * stride + row_bytes > size:
            raise FormatError(
                f"{name}: found {count} rows of {row_bytes} bytes, {stride} apart from byte {offset} on, in a bufferView "
                f"of {size} bytes; the count is wrong or the file damaged"
            )
        normalized = record.get("normalized") is True and dtype.kind in "iu"
        return Accessor(file, start + offset, stride, count, dtype, width, normalized, name)

    def _object(self, record: Mapping[str, Any], key: str) -> dict[str, Any]:
        return untrusted.as_object(untrusted.field(record, key, self.where), f"{self.where}: {key}")

    def _glb_text(self) -> bytes:
        size = self._path.stat().st_size
        version, length = self._numbers(4)
        if version != 2:
            raise FormatError(
                f"{self.where}: found version {version} of glTF, wanted 2; write it again with a newer program"
            )
        if length > size:
            raise FormatError(
                f"{self.where}: found {size} bytes, wanted the {length} that its header announces; it is cut off"
            )
        at, text = 12, None
        while at + 8 <= length:
            num_bytes, kind = self._numbers(at)
            if at + 8 + num_bytes > length:
                raise FormatError(
                    f"{self.where}: chunk at byte {at}: found {num_bytes} bytes announced, {length - at - 8} left"
                )
            if kind == 0x4E4F534A and text is None:
                if num_bytes > untrusted.MAX_JSON_BYTES:
                    raise FormatError(
                        f"{self.where}: found {num_bytes} bytes of JSON, wanted at most {untrusted.MAX_JSON_BYTES}"
                    )
                text = self._file.read(num_bytes)
            elif kind == 0x004E4942 and self._binary is None:
                self._binary = _Buffer(self._file, at + 8, num_bytes)
            at += 8 + (num_bytes + 3) // 4 * 4
        if text is None:
            raise FormatError(f"{self.where}: found no JSON chunk; the file is damaged")
        return text

    def _numbers(self, at: int) -> tuple[int, int]:
        self._file.seek(at)
        data = self._file.read(8)
        if len(data) < 8:
            raise FormatError(f"{self.where}: ends at byte {at + len(data)}; it is cut off")
        first, second = struct.unpack("<II", data)
        return first, second

    def _gltf_text(self) -> bytes:
        if self._path.stat().st_size > untrusted.MAX_JSON_BYTES:
            raise FormatError(f"{self.where}: found more than {untrusted.MAX_JSON_BYTES} bytes of JSON")
        self._file.seek(0)
        return self._file.read()

    def _buffer(self, index: int) -> _Buffer:
        if index in self._opened:
            return self._opened[index]
        record = self.item("buffers", index, f"{self.where}: buffers")
        name = f"{self.where}: buffers[{index}]"
        size = untrusted.integer(record, "byteLength", name, high=2**62)
        if "uri" in record:
            buffer = self._outside(untrusted.text(record, "uri", name), name)
        elif index == 0 and self._binary is not None:
            buffer = self._binary
        else:
            raise FormatError(f"{name}: found neither a uri nor a binary chunk{packed_hint(self.json)}")
        if size > buffer.num_bytes:
            raise FormatError(f"{name}: found {buffer.num_bytes} bytes, wanted {size}; it is cut off")
        self._opened[index] = buffer
        return buffer

    def _beside(self, uri: str, where: str) -> Path:
        from urllib.parse import unquote

        return untrusted.inner_file(self._path.parent, unquote(uri), where)

    def _outside(self, uri: str, where: str) -> _Buffer:
        """A buffer inside the JSON as base64, or in a file of the same folder."""
        if uri.startswith("data:"):
            head, _, body = uri.partition(",")
            if not head.endswith(";base64"):
                raise FormatError(f"{where}: found a data URI {head[:40]!r}, wanted base64")
            try:
                data = base64.b64decode(body, validate=True)
            except binascii.Error as error:
                raise FormatError(f"{where}: found base64 that cannot be read ({error})") from error
            self.num_bytes += len(data)
            return _Buffer(io.BytesIO(data), 0, len(data))
        path = self._beside(uri, where)
        try:
            size, file = path.stat().st_size, path.open("rb")
        except OSError as error:
            raise FormatError(f"{where}: {path}: cannot be read ({error.strerror or error})") from error
        self._files.append(file)
        self.num_bytes += size
        return _Buffer(file, 0, size)


def _readinto(file: BinaryIO, view: memoryview) -> int:
    done = 0
    while done < len(view) and (count := file.readinto(view[done:])):  # type: ignore[attr-defined]
        done += count
    return done
