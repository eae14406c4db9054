"""Writing an ``.spz``: codes of all planes are taken chunk by chunk, compressed as suits their bytes, and joined at the end.

A file has its planes one after the other, so what must come later waits in temporary files beside the target.
"""

import struct
import zlib
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, BinaryIO, Self

from splatree.io.formats.spz.container import ANTIALIASED, AXES_RECORD, HAS_EXTENSIONS, MAGIC, Header
from splatree.maths.axes import AXES
from splatree.shapes import Array

if TYPE_CHECKING:
    import zstandard

__all__ = ["PlaneWriter"]

_COPY_BYTES = 1 << 20


class PlaneWriter:
    """Takes codes of all planes chunk by chunk and writes the file at the end."""

    def __init__(self, header: Header, folder: Path, level: int | None) -> None:
        """``folder`` holds what has to wait; ``level`` is that of gzip or zstd."""
        self._header, self._level = header, level
        self._stack = ExitStack()
        self._folder = folder

    def __enter__(self) -> Self:
        import tempfile

        self._waiting: dict[str, IO[bytes]] = {}
        self._packers: dict[str, Any] = {}
        for name, width in self._header.planes().items():
            self._waiting[name] = self._stack.enter_context(tempfile.TemporaryFile(dir=self._folder))
            if self._header.version == 4:
                size = width * self._header.num_gaussians
                self._packers[name] = _zstd_compressor(name, size, self._level).compressobj(size=size)
        return self

    def __exit__(self, *exception: object) -> None:
        self._stack.close()

    def put(self, name: str, codes: Array) -> None:
        """The next rows of a plane."""
        data = codes.reshape(-1).data
        packer = self._packers.get(name)
        self._waiting[name].write(packer.compress(data) if packer else data)

    def finish(self, file: BinaryIO) -> None:
        """Write the whole file."""
        if self._header.version == 4:
            self._finish_zstd(file)
        else:
            self._finish_gzip(file)

    def _head(self, num_planes: int) -> bytes:
        header = self._header
        flags = ANTIALIASED * header.antialiased | HAS_EXTENSIONS * (header.axes is not None)
        fields = (header.version, header.num_gaussians, header.sh_degree, header.fractional_bits, flags, num_planes)
        return MAGIC + struct.pack("<IIBBBB", *fields)

    def _records(self) -> bytes:
        if self._header.axes is None:
            return b""
        return struct.pack("<III", AXES_RECORD, 4, AXES.index(self._header.axes) + 1)

    def _finish_zstd(self, file: BinaryIO) -> None:
        import shutil

        table = []
        for name, waiting in self._waiting.items():
            waiting.write(self._packers[name].flush())
            table += [waiting.tell(), self._header.planes()[name] * self._header.num_gaussians]
        records = self._records()
        file.write(self._head(len(self._waiting)) + struct.pack("<I12x", 32 + len(records)) + records)
        file.write(struct.pack(f"<{len(table)}Q", *table))
        for waiting in self._waiting.values():
            waiting.seek(0)
            shutil.copyfileobj(waiting, file, _COPY_BYTES)

    def _finish_gzip(self, file: BinaryIO) -> None:
        """One gzip member; each plane is deflated on its own, in the way that suits its bytes."""
        parts: list[tuple[str, Callable[[], Iterator[bytes]]]] = [("head", lambda: iter([self._head(0)]))]
        for name, waiting in self._waiting.items():
            parts.append((name, lambda waiting=waiting: _blocks(waiting)))  # type: ignore[misc]
        parts.append(("records", lambda: iter([self._records()])))
        file.write(b"\x1f\x8b\x08\0\0\0\0\0\0\xff")
        check = total = 0
        for name, blocks in parts:
            level, strategy = _DEFLATE.get(name, (1, zlib.Z_DEFAULT_STRATEGY))
            if self._level is not None:
                level, strategy = self._level, zlib.Z_DEFAULT_STRATEGY
            packer = zlib.compressobj(level, zlib.DEFLATED, -zlib.MAX_WBITS, 9, strategy)
            for block in blocks():
                check, total = zlib.crc32(block, check), total + len(block)
                file.write(packer.compress(block))
            # A full flush ends a plane on a byte without ending the stream: the next plane's stream goes on from there.
            file.write(packer.flush(zlib.Z_FINISH if name == "records" else zlib.Z_FULL_FLUSH))
        file.write(struct.pack("<II", check, total & 0xFFFFFFFF))


def _blocks(file: Any) -> Iterator[bytes]:
    file.seek(0)
    while block := file.read(_COPY_BYTES):
        yield block


_DEFLATE = {
    "positions": (1, zlib.Z_DEFAULT_STRATEGY),
    "alphas": (1, zlib.Z_HUFFMAN_ONLY),
    "colors": (1, zlib.Z_HUFFMAN_ONLY),
    "scales": (1, zlib.Z_HUFFMAN_ONLY),
    "rotations": (1, zlib.Z_HUFFMAN_ONLY),
    "harmonics": (4, zlib.Z_DEFAULT_STRATEGY),
}
"""Level and strategy of zlib for each plane. On a million Gaussians of a city: 4 % larger than level 6 for all, at 40 % of its
time. Bytes of alphas, colours, scales and rotations hardly repeat: looking for matches costs three times the coding."""


def _zstd_compressor(name: str, size: int, level: int | None) -> "zstandard.ZstdCompressor":
    """The compressor of a plane: of a level of zstd, or as suits its bytes.

    Harmonics are mostly few values, whose Huffman code is short already: only matches of seven bytes and more gain over it. The
    high bytes of positions match in threes, which the levels up to 12 do not look for. On a city a file is 5 % smaller than
    with level 3 at less of its time, and 10 % larger than with level 12 at an eighth.
    """
    import zstandard

    if level is not None:
        parameters = zstandard.ZstdCompressionParameters.from_level(level, source_size=size)
    else:
        # Small tables stay in the first caches, and the matches that are worth it are near.
        tables, min_match = ((16, 17), 7) if name == "harmonics" else ((14, 14), 3)
        parameters = zstandard.ZstdCompressionParameters(
            window_log=21, chain_log=tables[0], hash_log=tables[1], search_log=1, min_match=min_match, target_length=8,
            strategy=zstandard.STRATEGY_DFAST,
        )  # fmt: skip
    return zstandard.ZstdCompressor(compression_params=parameters)
