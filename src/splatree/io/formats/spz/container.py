"""What is round the planes of an ``.spz``: header, extension records, and the streams of gzip or zstd.

========  =================================================================================================
bytes     header
========  =================================================================================================
0, 4, 8   NGSP, version u4, Gaussians u4
12 … 15   degree of harmonics, fractional bits of positions, flags (1 antialiased, 2 extensions), planes (v4)
16        v4: byte at which the table of planes begins u4, 12 zeros; extension records lie before it
========  =================================================================================================

The planes of version 4 are streams of their own: a reader takes bytes of each as it needs them, and keeps no more than the rows
in hand. Those of versions 1 to 3 are one stream, plane after plane, which is inflated once and kept as it is, 20 to 65 bytes a
Gaussian. `spz/plane_writer.py` writes.
"""

import gzip
import io
import struct
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, BinaryIO, cast

from splatree.errors import FormatError
from splatree.maths.axes import AXES

if TYPE_CHECKING:
    pass

MAGIC = b"NGSP"
GZIP_MAGIC = b"\x1f\x8b"

ANTIALIASED, HAS_EXTENSIONS = 1, 2
"""Bits of the flags."""

AXES_RECORD = 0xADBE0003
"""Type of the extension record SPZ_ADOBE_coordinate_system: a u4, one more than the index in `AXES`."""

_EXTENSION_BYTES_MAX = 1 << 20
"""More of extension records is refused: those that are known take 4 and 12 bytes."""

_GAUSSIANS_PER_BYTE = 16
"""More Gaussians than this for a byte of the file (real ones take ten bytes and more) is a decompression bomb …"""

_GAUSSIANS_ALWAYS = 1 << 20
"""… unless there are no more than this."""

_WINDOW_MIN = 1 << 23
"""zstd frames may ask for a window of this size, or of their plane's if it is larger."""

_INFLATE_BYTES = 1 << 18
_READ_BYTES = 1 << 17


@dataclass(frozen=True)
class Header:
    """What is said of all planes."""

    version: int
    """1 to 4."""
    num_gaussians: int
    """Rows of each plane."""
    sh_degree: int
    """Degree of the harmonics, 0 to 4."""
    fractional_bits: int
    """Bits of a position below the point."""
    antialiased: bool
    """Whether the scene is drawn in the mode `antialiased`."""
    axes: str | None = None
    """Frame that an extension record names; None: none does."""

    def planes(self) -> dict[str, int]:
        """Bytes a row of each plane, in the order of the file."""
        rest = 3 * ((self.sh_degree + 1) ** 2 - 1)
        widths = {
            "positions": 6 if self.version == 1 else 9,
            "alphas": 1,
            "colors": 3,
            "scales": 3,
            "rotations": 3 if self.version <= 2 else 4,
            "harmonics": rest,
        }
        return {name: width for name, width in widths.items() if width and self.num_gaussians}


class Planes:
    """The planes of a file, one after the other."""

    def __init__(self, file: BinaryIO, num_bytes: int, where: str) -> None:
        """Read the header from the start of ``file``; errors name ``where``."""
        self._file, self._num_bytes, self._where = file, num_bytes, where
        self._gzip: gzip.GzipFile | None = None
        file.seek(0)
        head = file.read(4)
        if head[:2] == GZIP_MAGIC:
            file.seek(0)
            self._gzip = gzip.GzipFile(fileobj=file, mode="rb")
            head = self._read(self._gzip, 16)
        else:
            head += file.read(28)
        self.header, self._has_extensions, self._num_planes = self._parse(head)
        count = self.header.num_gaussians
        if count > max(_GAUSSIANS_ALWAYS, _GAUSSIANS_PER_BYTE * num_bytes):
            raise FormatError(
                f"{where}: found {count} Gaussians in {num_bytes} bytes, wanted at most {_GAUSSIANS_PER_BYTE} a byte; the "
                "count is wrong or the file is a decompression bomb"
            )
        self._inflated: dict[str, bytearray] = {}
        if self._gzip is not None:
            self._inflate(self._gzip)

    def open(self, file: BinaryIO) -> Callable[[int], Iterator[tuple[str, memoryview]]]:
        """Start a pass over the rows of the same file: what it returns gives each plane's name and the bytes of its next rows.

        They are valid until the next call; the last rows end every plane.
        """
        if self._gzip is not None:
            return self._open_inflated()
        return self._open_streams(file)

    def _open_inflated(self) -> Callable[[int], Iterator[tuple[str, memoryview]]]:
        widths, begin = self.header.planes(), 0

        def take(count: int) -> Iterator[tuple[str, memoryview]]:
            nonlocal begin
            for name, data in self._inflated.items():
                yield name, memoryview(data)[begin * widths[name] : (begin + count) * widths[name]]
            begin += count

        return take

    def _open_streams(self, file: BinaryIO) -> Callable[[int], Iterator[tuple[str, memoryview]]]:
        import zstandard

        streams = {}
        for (name, width), (at, size) in zip(self.header.planes().items(), self._places, strict=True):
            window = max(_WINDOW_MIN, 2 * width * self.header.num_gaussians)
            decompressor = zstandard.ZstdDecompressor(max_window_size=min(window, 1 << 31))
            part = cast(BinaryIO, _Part(file, at, size))
            streams[name] = decompressor.stream_reader(part, read_size=_READ_BYTES, closefd=False)
        buffers = {name: bytearray() for name in streams}
        begin = 0

        def take(count: int) -> Iterator[tuple[str, memoryview]]:
            nonlocal begin
            begin += count
            for name, width in self.header.planes().items():
                if len(buffers[name]) < count * width:
                    buffers[name] = bytearray(count * width)
                codes = memoryview(buffers[name])[: count * width]
                self._fill(streams[name], codes, f"plane {name}")
                yield name, codes
                if begin == self.header.num_gaussians and streams[name].read(1):
                    raise FormatError(
                        f"{self._where}: plane {name}: found more bytes than its rows take; it is damaged"
                    )

        return take

    @property
    def axes(self) -> str | None:
        """Frame that an extension record names."""
        return self._axes

    def _parse(self, head: bytes) -> tuple[Header, bool, int]:
        where = self._where
        if len(head) < 16 or head[:4] != MAGIC:
            raise FormatError(f"{where}: found {head[:4]!r} at its start, wanted {MAGIC!r}; this is no .spz")
        version, count, degree, bits, flags, num_planes = struct.unpack("<IIBBBB", head[4:16])
        versions = range(1, 4) if self._gzip else range(4, 5)
        if version not in versions:
            raise FormatError(
                f"{where}: found version {version}, wanted {' or '.join(map(str, versions))} "
                f"{'inside gzip' if self._gzip else 'without gzip'}; a newer file needs a newer splatree"
            )
        if degree > 4:
            raise FormatError(f"{where}: found harmonics of degree {degree}, wanted 0 to 4")
        if bits > 30:
            raise FormatError(f"{where}: found {bits} fractional bits, wanted at most 30")
        self._axes: str | None = None
        header = Header(version, count, degree, bits, bool(flags & ANTIALIASED))
        if version == 4:
            self._read_table(head, header, num_planes, has_extensions=bool(flags & HAS_EXTENSIONS))
        return header, bool(flags & HAS_EXTENSIONS), num_planes

    def _read_table(self, head: bytes, header: Header, num_planes: int, *, has_extensions: bool) -> None:
        """Extension records, and where each plane lies."""
        where, wanted = self._where, header.planes()
        (table_at,) = struct.unpack("<I", head[16:20].ljust(4, b"\0"))
        first = table_at + 16 * num_planes
        if (
            len(head) < 32
            or not 32 <= table_at <= min(32 + _EXTENSION_BYTES_MAX, self._num_bytes)
            or first > self._num_bytes
        ):
            raise FormatError(
                f"{where}: found the table of planes at byte {table_at} of {self._num_bytes}, wanted it behind the header and "
                "inside the file; it is cut off or damaged"
            )
        if num_planes != len(wanted):
            raise FormatError(f"{where}: found {num_planes} planes, wanted {len(wanted)} ({', '.join(wanted)})")
        self._file.seek(32)
        if has_extensions:
            self._axes = _axes_from_records(self._file.read(table_at - 32), where)
        self._file.seek(table_at)
        table = struct.unpack(f"<{2 * num_planes}Q", self._file.read(16 * num_planes))
        self._places: list[tuple[int, int]] = []
        at = first
        for (name, width), packed, raw in zip(wanted.items(), table[::2], table[1::2], strict=True):
            if raw != width * header.num_gaussians or packed > self._num_bytes - at:
                raise FormatError(
                    f"{where}: plane {name}: found {packed} bytes for {raw} at byte {at} of {self._num_bytes}, wanted "
                    f"{width * header.num_gaussians} ({width} for each Gaussian) inside the file; it is cut off or damaged"
                )
            self._places.append((at, packed))
            at += packed
        if at != self._num_bytes:
            raise FormatError(
                f"{where}: found {self._num_bytes - at} bytes behind the last plane, wanted none; it is damaged"
            )

    def _inflate(self, stream: gzip.GzipFile) -> None:
        """Inflate all planes, as far as there is something to inflate: no count in a header makes us keep more."""
        for name, width in self.header.planes().items():
            plane = self._inflated[name] = bytearray()
            left = width * self.header.num_gaussians
            while left:
                block = bytearray(min(left, _INFLATE_BYTES))
                self._fill(stream, memoryview(block), f"plane {name}")
                plane += block
                left -= len(block)
        self._finish_gzip(stream)

    def _finish_gzip(self, stream: gzip.GzipFile) -> None:
        """Extension records behind the planes; and the check sum, which gzip compares at its end."""
        rest = bytearray(_EXTENSION_BYTES_MAX + 1)
        size = self._readinto(stream, memoryview(rest), "its end")
        if size > _EXTENSION_BYTES_MAX:
            raise FormatError(
                f"{self._where}: found more than {_EXTENSION_BYTES_MAX} bytes behind its planes; it is damaged"
            )
        if self._has_extensions:
            self._axes = _axes_from_records(bytes(rest[:size]), self._where)

    def _read(self, stream: Any, count: int) -> bytes:
        data = bytearray(count)
        self._fill(stream, memoryview(data), "header")
        return bytes(data)

    def _fill(self, stream: Any, view: memoryview, what: str) -> None:
        size = self._readinto(stream, view, what)
        if size < len(view):
            raise FormatError(
                f"{self._where}: {what}: ends {len(view) - size} bytes early; the file is cut off or damaged"
            )

    def _readinto(self, stream: Any, view: memoryview, what: str) -> int:
        """Fill the view as far as the stream goes; return how far."""
        errors: tuple[type[Exception], ...] = (gzip.BadGzipFile, EOFError, zlib.error)
        if self._gzip is None:
            import zstandard

            errors = (zstandard.ZstdError,)
        done = 0
        try:
            while done < len(view) and (count := stream.readinto(view[done:])):
                done += count
        except errors as error:
            raise FormatError(f"{self._where}: {what}: cannot be inflated ({error}); the file is damaged") from error
        return done


class _Part(io.RawIOBase):
    """A range of a file."""

    def __init__(self, file: BinaryIO, start: int, size: int) -> None:
        super().__init__()
        self._file, self._at, self._end = file, start, start + size

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: Any, /) -> int:
        view = memoryview(buffer)[: self._end - self._at]
        self._file.seek(self._at)
        count = self._file.readinto(view) if len(view) else 0  # type: ignore[attr-defined]
        self._at += count
        return int(count)


def _axes_from_records(data: bytes, where: str) -> str | None:
    """The frame that one of the records names; records of other types are passed over by their length."""
    axes, at = None, 0
    while at < len(data):
        kind, size = struct.unpack("<II", data[at : at + 8]) if len(data) - at >= 8 else (0, len(data))
        if size > len(data) - at - 8:
            raise FormatError(
                f"{where}: extension record {kind:#010x}: found {size} bytes announced and {len(data) - at - 8} left; "
                "the file is damaged"
            )
        if kind == AXES_RECORD:
            value = int.from_bytes(data[at + 8 : at + 8 + size], "little") if size == 4 else 0
            if not 1 <= value <= len(AXES):
                raise FormatError(
                    f"{where}: found axes {value}, wanted 1 to {len(AXES)} ({' '.join(AXES)}); frames with z upright are not "
                    "read, convert it to RUB with the tools of the format"
                )
            axes = AXES[value - 1]
        at += 8 + size
    return axes
