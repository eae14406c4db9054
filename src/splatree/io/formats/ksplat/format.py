"""``.ksplat`` (GaussianSplats3D): sections of fixed records, as floats (level 0) or in 16 and 8 bits (levels 1 and 2).

A header of 4096 bytes, 1024 bytes for each section, then each section: the lengths of its partly filled buckets, the centres
of its buckets, its records.

======  ==================================  ===============================================================
column  level 0                             levels 1 and 2
======  ==================================  ===============================================================
mean    3 f4                                3 u2: bucket centre + (u − range) · (block size / 2) / range
scale   3 f4, linear                        3 f2, linear
quat    4 f4 wxyz                           4 f2 wxyz
RGBA    4 u1: ½ + C0 dc, and the opacity    the same
rest    f4                                  f2 (level 1), u1 between the header's minimum and maximum (level 2)
======  ==================================  ===============================================================

Harmonics go degree by degree, and within a degree channel by channel: 3 of red, 3 of green, 3 of blue, then 5 of red and so on.
Degrees 0 to 2 are written, as the format's own viewer has no third; a third is read. docs/reference/formats/ksplat.md.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np

from splatree.errors import FormatError
from splatree.io.chunks import Chunks
from splatree.io.formats.ksplat.layout import (
    CODE_RANGE,
    COLORS,
    HALF_MAX,
    HALF_MIN,
    HEADER,
    HEADER_BYTES,
    LOGITS,
    REST_RANGE,
    SECTION,
    SECTION_BYTES,
    SHARE,
    record_of,
    rest_order,
)
from splatree.io.options import ReadOptions
from splatree.io.rows import FileRows, Fill, records_of
from splatree.scene.gaussians import Gaussians
from splatree.scene.scene import Scene
from splatree.shapes import Array


@dataclass(frozen=True)
class _File:
    """What the headers say, checked against the size of the file."""

    level: int
    rest_range: tuple[float, float]
    sections: Array  # of SECTION
    starts: list[int]  # byte of each section

    @property
    def degree(self) -> int:
        return int(self.sections["degree"].max(initial=0))


def sniff(path: Path, head: bytes) -> bool:
    """Whether the headers fit the size of the file to the byte: the only mark is a version of 0.1."""
    if len(head) < HEADER_BYTES or head[:4] != b"\x00\x01\x00\x00" or not path.is_file():
        return False
    try:
        with path.open("rb") as file:
            _parse(path, file)
    except FormatError:
        return False
    return True


def read(path: Path, options: ReadOptions) -> Scene:
    """Read all sections, one after the other, at the highest degree among them."""
    return _open(path).scene(options)


def read_chunks(path: Path, options: ReadOptions) -> Chunks:
    """The same values in chunks."""
    return _open(path).chunks(options)


def _open(path: Path) -> FileRows:
    with path.open("rb") as file:
        found = _parse(path, file)
        sections = [
            _Section(file, found, section, start, f"{path}: section {number}")
            for number, (section, start) in enumerate(zip(found.sections, found.starts, strict=True))
        ]
    ends = np.cumsum([section.num_rows for section in sections], dtype=np.int64)

    @contextmanager
    def start() -> Iterator[Fill]:
        with path.open("rb") as file:

            def fill(begin: int, out: Gaussians) -> None:
                end, done = begin + len(out), begin
                while done < end:
                    index = int(np.searchsorted(ends, done, side="right"))
                    first = int(ends[index]) - sections[index].num_rows
                    stop = min(end, int(ends[index]))
                    sections[index].fill(file, done - first, out.rows(done - begin, stop - begin))
                    done = stop

            yield fill

    return FileRows(str(path), int(ends[-1]) if len(ends) else 0, found.degree, start)


def _parse(path: Path, file: BinaryIO) -> _File:
    num_bytes = path.stat().st_size
    data = file.read(HEADER_BYTES)
    if len(data) < HEADER_BYTES:
        raise FormatError(f"{path}: found {len(data)} bytes, wanted a header of {HEADER_BYTES}; the file is cut off")
    header = np.frombuffer(data, HEADER)[0]
    level, num_sections = int(header["level"]), int(header["max_sections"])
    if header["major"] != 0 or header["minor"] != 1:
        raise FormatError(f"{path}: found version {header['major']}.{header['minor']}, wanted 0.1")
    if level > 2:
        raise FormatError(f"{path}: found compression level {level}, wanted 0, 1 or 2")
    if HEADER_BYTES + num_sections * SECTION_BYTES > num_bytes:
        raise FormatError(
            f"{path}: found {num_bytes} bytes, wanted more for {num_sections} section headers; it is cut off"
        )
    sections = np.frombuffer(file.read(num_sections * SECTION_BYTES), SECTION)
    starts, end = [], HEADER_BYTES + num_sections * SECTION_BYTES
    for number, section in enumerate(sections):
        _check_section(section, level, f"{path}: section {number}")
        starts.append(end)
        record = record_of(level, int(section["degree"]))
        end += 4 * int(section["partial_buckets"]) + int(section["bucket_bytes"]) * int(section["buckets"])
        end += record.itemsize * int(section["max_rows"])
    if end != num_bytes:
        raise FormatError(
            f"{path}: found {num_bytes} bytes, wanted {end} for its {num_sections} sections; it is cut off or damaged"
        )
    low, high = (float(end) or default for end, default in zip(header["rest_range"], REST_RANGE, strict=True))
    if not -HALF_MAX <= low < high <= HALF_MAX:
        raise FormatError(f"{path}: found harmonics between {low} and {high}, wanted a range of finite numbers")
    return _File(level, (low, high), sections, starts)


def _check_section(section: np.void, level: int, where: str) -> None:
    if section["degree"] > 3:
        raise FormatError(f"{where}: found harmonics of degree {section['degree']}, wanted 0 to 3")
    if section["rows"] > section["max_rows"]:
        raise FormatError(
            f"{where}: found {section['rows']} splats, wanted at most the {section['max_rows']} it has room for"
        )
    if level == 0:
        return
    if section["bucket_bytes"] != 12:
        raise FormatError(f"{where}: found {section['bucket_bytes']} bytes a bucket, wanted 12")
    if not 0 < section["block_size"] < np.inf:
        raise FormatError(f"{where}: found a block size of {section['block_size']}, wanted more than 0, finite")
    if int(section["full_buckets"]) + int(section["partial_buckets"]) != section["buckets"]:
        raise FormatError(
            f"{where}: found {section['buckets']} buckets, wanted the {section['full_buckets']} full and "
            f"{section['partial_buckets']} partial ones it counts"
        )


class _Section:
    """Where the records of a section are, and what their codes stand for."""

    def __init__(self, file: BinaryIO, found: _File, section: np.void, start: int, where: str) -> None:
        self.num_rows = int(section["rows"])
        self._where, self._level, degree = where, found.level, int(section["degree"])
        self._record, self._rest_places = record_of(found.level, degree), 3 + rest_order(degree)
        file.seek(start)
        lengths = records_of(file, np.dtype("<u4"), int(section["partial_buckets"]))
        bucket_bytes = int(section["bucket_bytes"]) * int(section["buckets"])
        self._start = start + lengths.nbytes + bucket_bytes
        if found.level > 0:
            self._centres = records_of(file, np.dtype("<f4"), bucket_bytes // 4).reshape(-1, 3)
            full = np.full(int(section["full_buckets"]), int(section["bucket_rows"]), np.int64)
            self._bucket_ends = np.cumsum(np.concatenate([full, lengths.astype(np.int64)]))
            ends = self._bucket_ends
            if self.num_rows > (ends[-1] if len(ends) else 0):
                raise FormatError(f"{where}: found buckets of {ends[-1:].sum()} splats in all, wanted {self.num_rows}")
            self._code_range = int(section["code_range"]) or CODE_RANGE
            self._step = float(section["block_size"]) / 2 / self._code_range
        low, high = found.rest_range
        self._rest_table = (low + (high - low) * SHARE).astype(np.float32)

    def fill(self, file: BinaryIO, first: int, out: Gaussians) -> None:
        """Decode the rows from ``first`` on."""
        file.seek(self._start + first * self._record.itemsize)
        records = records_of(file, self._record, len(out))
        if len(records) < len(out):
            raise FormatError(f"{self._where}: cannot be read to its end; did the file change meanwhile?")
        if self._level > 0:
            bucket = np.searchsorted(self._bucket_ends, np.arange(first, first + len(out)), side="right")
            means = (records["mean"].astype(np.float64) - self._code_range) * self._step + self._centres[bucket]
            out.means[:] = means
            scale = np.maximum(records["scale"].astype(np.float32), np.float32(HALF_MIN / 2))
        else:
            out.means[:], scale = records["mean"], records["scale"]
        with np.errstate(divide="ignore", invalid="ignore"):  # what has no logarithm is found by the check of values
            np.log(scale, out=out.log_scales)
        out.quats[:] = records["quat"]
        out.logit_opacities[:] = LOGITS[records["rgba"][:, 3]]
        out.sh[:, 0] = COLORS[records["rgba"][:, :3]]
        sh = out.sh.reshape(len(out), -1)
        sh[:, 3 + len(self._rest_places) :] = 0  # of a degree that other sections have
        sh[:, self._rest_places] = self._rest_table[records["rest"]] if self._level == 2 else records["rest"]
